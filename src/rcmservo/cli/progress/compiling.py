"""Progress of the compilation by Numba.

The module imports Numba, so a command imports it only when it begins to compute.
"""

from typing import Any, cast

from numba.core import event
from rich.live import Live
from rich.text import Text

from rcmservo.cli.terminal import can_rewrite_lines
from rcmservo.numerics.jit import count_kernels

PARTS_PER_LINE = 20
"""Compiled parts per printed line, if the terminal cannot rewrite lines."""


class CompilationListener(event.Listener):
    """Listener that reports each part that is compiled, but no part that is read from the cache."""

    def __init__(self, line: Live) -> None:
        self._line, self._count, self._all = line, 0, count_kernels()

    def on_start(self, event: event.Event) -> None:
        """Ignore the start of a part; the parts that it calls are counted separately."""

    def on_end(self, event: event.Event) -> None:
        """Count a completed part, except one of another package."""
        data = cast(Any, event.data)
        if not data["dispatcher"].__module__.startswith("rcmservo."):
            return
        self._count += 1
        self._all = max(self._all, self._count)  # some parts are compiled for several types
        words = f"compiling, {self._count} of about {self._all} parts; the next start is quicker"
        self._line.update(Text(words, style="dim"), refresh=True)
        if self._count % PARTS_PER_LINE == 1 and not can_rewrite_lines(self._line.console):
            self._line.console.print(words, soft_wrap=True)
