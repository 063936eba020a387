"""Memory that the kernel leaves as it is.

NumPy asks that its large arrays be gathered into huge pages. Linux does that later, each 10 s, in a
thread of its own: where the kernel is not preemptible, that thread keeps a processor for 6 ms at a
time, several times in a row, whatever goes first (42 ms were measured: a controller that waits for
40 ms then stops the arm). A process that is not to wait for it asks that its memory be left alone.
"""

import ctypes
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

SET, GET = 41, 42
"""PR_SET_THP_DISABLE and PR_GET_THP_DISABLE, of prctl."""


@contextmanager
def left_alone() -> Generator[None]:
    """No huge pages are made of this process's memory while the context is open, and never of that
    of processes that are started in it. Nothing happens where the system knows nothing of it."""
    system: Any = ctypes.CDLL(None)
    if not hasattr(system, "prctl"):
        yield
        return
    before = system.prctl(GET, 0, 0, 0, 0)
    system.prctl(SET, 1, 0, 0, 0)
    try:
        yield
    finally:
        system.prctl(SET, max(before, 0), 0, 0, 0)
