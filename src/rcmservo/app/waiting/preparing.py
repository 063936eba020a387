"""What a command needs before it starts: the simulator installed, and the kernels compiled."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rcmservo.errors import RcmServoError

if TYPE_CHECKING:
    from rich.live import Live


@contextmanager
def compiling(line: "Live") -> Generator[None]:
    """Tell on a live line what is compiled in here."""
    from numba.core import event

    from rcmservo.app.waiting.compiling import Compiling

    with event.install_listener("numba:compile", Compiling(line)):
        yield


@contextmanager
def simulator(command: str) -> Generator[None]:
    """Import what simulates in here: where it is not installed, that is one sentence."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise RcmServoError(
            f"{command} needs the simulator, and {error.name} is not installed: pip install "
            f"'rcmservo[sim]'"
        ) from error
