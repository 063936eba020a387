"""Reports of the parts that Numba compiles. It imports Numba, so a command imports it only when it
begins to compute.
"""

from typing import Any, cast

from numba.core import event
from rich.live import Live
from rich.text import Text

from rcmservo.cli.terminal import can_rewrite_lines
from rcmservo.numerics.jit import parts

PARTS_PER_LINE = 20
"""Parts after which a lasting line is printed where no live line is seen."""


class CompilationListener(event.Listener):
    """Tells of every part that is compiled; of one that is in the cache, nothing."""

    def __init__(self, line: Live) -> None:
        self._line, self._count, self._all = line, 0, parts()

    def on_start(self, event: event.Event) -> None:
        """A part begins; the parts that it calls count for themselves."""

    def on_end(self, event: event.Event) -> None:
        """A part is done; those of other packages are not counted."""
        data = cast(Any, event.data)
        if not data["dispatcher"].__module__.startswith("rcmservo."):
            return
        self._count += 1
        self._all = max(self._all, self._count)  # some are compiled for more than one type
        words = f"compiling, {self._count} of about {self._all} parts: the next start is quicker"
        self._line.update(Text(words, style="dim"), refresh=True)
        if self._count % PARTS_PER_LINE == 1 and not can_rewrite_lines(self._line.console):
            self._line.console.print(words, soft_wrap=True)
