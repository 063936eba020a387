"""Progress of the compilation of kernels, and compilation in a second process."""

from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, cast

from rich.text import Text

from rcmservo.cli.terminal import can_rewrite_lines
from rcmservo.live.child_process import ChildProcess
from rcmservo.numerics.jit import count_kernels, is_cache_empty

if TYPE_CHECKING:
    from rich.live import Live

KERNELS_PER_PRINTED_LINE = 20
"""Number of compiled kernels between two printed lines, if the terminal cannot rewrite lines."""


class CompilationProgress:
    """Status line with the number of compiled kernels; call it after each kernel."""

    def __init__(self, status_line: "Live") -> None:
        self._status_line, self._compiled, self._expected = status_line, 0, count_kernels()

    def __call__(self) -> None:
        """Count a compiled kernel."""
        self._compiled += 1
        # a kernel is compiled several times if it is called with several types
        words = f"compiling, {self._compiled} of about {max(self._expected, self._compiled)} parts"
        text = f"{words}; the next start is quicker"
        self._status_line.update(Text(text, style="dim"), refresh=True)
        is_printed = self._compiled % KERNELS_PER_PRINTED_LINE == 1
        if is_printed and not can_rewrite_lines(self._status_line.console):
            self._status_line.console.print(text, soft_wrap=True)


@contextmanager
def report_compilation(status_line: "Live") -> Generator[Callable[[], None]]:
    """Report on a status line each kernel that Numba compiles inside the context.

    The context gives the function that counts one more kernel.
    """
    progress = CompilationProgress(status_line)
    with _call_after_each_kernel(progress):
        yield progress


@contextmanager
def compiled_in_parallel(
    warm_up: Callable[[], object], count_kernel: Callable[[], None]
) -> Generator[None]:
    """Call `warm_up` in a second process while the context runs, if the cache holds no kernel.

    The context ends once `warm_up` has ended, and what it has compiled is in the cache. On two
    processors a first simulated run starts after 46 s instead of 71. An error of `warm_up` is not
    raised here: the caller calls `warm_up` after the context, where the error occurs again.

    Parameters
    ----------
    warm_up : Callable
        Function that compiles. It is pickled.
    count_kernel : Callable
        Function that is called after the body of the context, one time per kernel that the second
        process has compiled.
    """
    if not is_cache_empty():
        yield
        return
    child = ChildProcess(get_context("spawn"), _compile_and_report, warm_up)
    try:
        yield
        with suppress(EOFError, OSError):
            while child.pipe.recv():
                count_kernel()
    finally:
        child.process.kill()
        child.end()


def _compile_and_report(warm_up: Callable[[], object], pipe: Any) -> None:
    """Call `warm_up`, and send a message for each kernel that it compiles."""
    with suppress(Exception), _call_after_each_kernel(lambda: pipe.send(True)):
        warm_up()


@contextmanager
def _call_after_each_kernel(function: Callable[[], None]) -> Generator[None]:
    """Call a function for each kernel that Numba compiles inside the context.

    A kernel that is read from the cache does not count, nor does one of another package. Numba is
    imported here and not above, so that the help of a command stays quick.
    """
    from numba.core import event

    class CompilationListener(event.Listener):
        """Listener that calls the function."""

        def on_start(self, event: event.Event) -> None:
            """Do nothing: a kernel counts when its compilation ends."""

        def on_end(self, event: event.Event) -> None:
            """Call the function if the compiled kernel is one of this package."""
            if cast(Any, event.data)["dispatcher"].__module__.startswith("rcmservo."):
                function()

    with event.install_listener("numba:compile", CompilationListener()):
        yield
