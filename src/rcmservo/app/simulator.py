"""The simulator is an extra: a command that needs it says how to install it."""

import contextlib
from collections.abc import Generator

from rcmservo.errors import RcmServoError


@contextlib.contextmanager
def simulator(command: str) -> Generator[None]:
    """Import what simulates in here: where it is not installed, that is one sentence."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise RcmServoError(
            f"{command} needs the simulator, and {error.name} is not installed: pip install "
            f"'rcmservo[sim]'"
        ) from error
