"""Progress report on the compilation of the kernels, while a command prepares its work."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

from rich.text import Text

from rcmservo.cli.terminal import can_rewrite_lines

if TYPE_CHECKING:
    from rich.live import Live

KERNELS_PER_PRINTED_LINE = 20
"""Number of compiled kernels between two printed lines, if the terminal cannot rewrite lines."""


@contextmanager
def report_compilation(status_line: "Live") -> Generator[None]:
    """Report on a status line each kernel that Numba compiles inside the context.

    A kernel that is read from the cache is not reported, nor is one of another package. Numba is
    imported here and not above, so that the help of a command stays quick.
    """
    from numba.core import event

    from rcmservo.numerics import jit

    class CompilationListener(event.Listener):
        """Listener that counts the compiled kernels."""

        compiled_count = 0
        expected_count = jit.count_kernels()

        def on_start(self, event: event.Event) -> None:
            """Ignore the start; the kernels that this kernel calls are counted separately."""

        def on_end(self, event: event.Event) -> None:
            """Count a compiled kernel of this package."""
            data = cast(Any, event.data)
            if not data["dispatcher"].__module__.startswith("rcmservo."):
                return
            self.compiled_count += 1
            # a kernel is compiled several times if it is called with several types
            total = max(self.expected_count, self.compiled_count)
            words = f"compiling, {self.compiled_count} of about {total} parts"
            text = f"{words}; the next start is quicker"
            status_line.update(Text(text, style="dim"), refresh=True)
            is_printed = self.compiled_count % KERNELS_PER_PRINTED_LINE == 1
            if is_printed and not can_rewrite_lines(status_line.console):
                status_line.console.print(text, soft_wrap=True)

    with event.install_listener("numba:compile", CompilationListener()):
        yield
