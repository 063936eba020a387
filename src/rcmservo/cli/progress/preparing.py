"""Progress of the compilation of the kernels before a command starts."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.live import Live


@contextmanager
def compiling(line: "Live") -> Generator[None]:
    """Report on a status line the parts that are compiled inside the context."""
    from numba.core import event

    from rcmservo.cli.progress.compiling import CompilationListener

    with event.install_listener("numba:compile", CompilationListener(line)):
        yield
