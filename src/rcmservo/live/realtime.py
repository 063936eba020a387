"""Real-time settings of a process that moves an arm, so that nothing delays its loop for long.

Python's garbage collector can pause a large program for 0.1 s. It is off while an arm moves, and
objects made before are excluded from collection. Another Python thread could hold the interpreter's
lock for 5 ms, so the switch interval is shortened. The operating system gives this thread a
real-time priority and keeps its memory in RAM.

The other threads of the process come next, before all other work of the computer: a thread that
holds the interpreter's lock while it waits for a processor delays the loop too. A thread that sends
commands to a device requests a priority above theirs: `urgent`.

NumPy requests huge pages for large arrays. Linux assembles them later, every 10 s, in a kernel
thread. On a kernel without preemption that thread occupies a processor for 6 ms at a time, several
times in a row, whatever the priorities (42 ms were measured; a controller with a time-out of 40 ms
then stops the arm). The process therefore uses no huge pages.
"""

import ctypes
import gc
import logging
import os
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

SWITCH_INTERVAL_S = 0.0005
"""Time in s after which another Python thread must release the interpreter's lock."""

LOOP_PRIORITY = 20
"""Real-time priority of the loop (1 to 99): above ordinary work, below the kernel's device work."""

OTHER_PRIORITY = 10
"""Real-time priority of the other threads."""

URGENT_PRIORITY = 15
"""Real-time priority of a thread that sends the loop's commands to a device."""

REFUSED = "real-time scheduling was refused"

CURRENT, ON_FAULT = 1, 4
"""Flags of mlockall: lock the pages that are mapped and in memory, and others on first use."""

SET_NO_HUGE_PAGES, GET_NO_HUGE_PAGES = 41, 42
"""PR_SET_THP_DISABLE and PR_GET_THP_DISABLE of prctl."""


@dataclass
class Realtime:
    """Result of the requests to the operating system.

    Parameters
    ----------
    refused : list[str]
        One sentence for each refused request.
    collections : int
        Number of garbage collections that paused the process nevertheless.
    """

    refused: list[str] = field(default_factory=list[str])
    collections: int = 0

    def _count(self, moment: str, about: object) -> None:
        self.collections += moment == "start"


@contextmanager
def realtime() -> Generator[Realtime]:
    """Give the calling thread the first priority, and the existing threads the next one.

    The priorities hold while the context is open. Threads that are started inside keep the ordinary
    priority.
    """
    got = Realtime()
    interval, collecting = sys.getswitchinterval(), gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    gc.callbacks.append(got._count)  # pyright: ignore[reportPrivateUsage]
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    before = _raise_priorities(got)
    locked = _lock_memory(got)
    try:
        with without_huge_pages():
            yield got
    finally:
        if locked:
            _system().munlockall()
        for thread, policy, priority in before:
            with suppress(ProcessLookupError):  # it has ended
                _schedule(thread, policy, priority)
        sys.setswitchinterval(interval)
        gc.callbacks.remove(got._count)  # pyright: ignore[reportPrivateUsage]
        gc.unfreeze()
        if collecting:
            gc.enable()


@contextmanager
def without_huge_pages() -> Generator[None]:
    """Disable huge pages for this process while the context is open.

    Processes that are started inside have none permanently. Does nothing on systems other than
    Linux.
    """
    system: Any = ctypes.CDLL(None)
    if not hasattr(system, "prctl"):
        yield
        return
    before = system.prctl(GET_NO_HUGE_PAGES, 0, 0, 0, 0)
    system.prctl(SET_NO_HUGE_PAGES, 1, 0, 0, 0)
    try:
        yield
    finally:
        system.prctl(SET_NO_HUGE_PAGES, max(before, 0), 0, 0, 0)


def urgent() -> str:
    """Give the calling thread a priority just below that of the loop, until it ends.

    Returns
    -------
    str
        Empty, or a sentence that says why the system refused. The refusal is logged.
    """
    try:
        _schedule(threading.get_native_id(), os.SCHED_FIFO, URGENT_PRIORITY)
    except (AttributeError, OSError) as error:
        why = f"{REFUSED} ({_why(error)}): other work may delay what goes to the device"
        logging.getLogger(__name__).info(why)
        return why
    return ""


def _raise_priorities(got: Realtime) -> list[tuple[int, int, int]]:
    """Request real-time scheduling.

    Return each changed thread with its former policy and priority.
    """
    this = threading.get_native_id()
    others = [thread.native_id for thread in threading.enumerate()]
    before: list[tuple[int, int, int]] = []
    try:
        for thread in (this, *(other for other in others if other is not None and other != this)):
            was = os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority
            if thread != this and was[1] > OTHER_PRIORITY:
                continue  # an urgent thread keeps its own priority
            priority = LOOP_PRIORITY if thread == this else OTHER_PRIORITY
            _schedule(thread, os.SCHED_FIFO, priority)
            before.append((thread, *was))
    except (AttributeError, OSError) as error:
        got.refused.append(f"{REFUSED} ({_why(error)}): other work may delay the loop")
    return before


def _schedule(thread: int, policy: int, priority: int) -> None:
    """Set a thread's scheduling, which threads that it starts do not inherit."""
    os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _lock_memory(got: Realtime) -> bool:
    """Lock the memory of the process in RAM; return False if the system refuses."""
    try:
        system = _system()
        if system.mlockall(CURRENT | ON_FAULT) == 0:
            return True
        why = os.strerror(ctypes.get_errno())
    except (AttributeError, OSError) as error:
        why = _why(error)
    got.refused.append(f"locking memory was refused ({why}): paging may delay the loop")
    return False


def _system() -> Any:
    return ctypes.CDLL(None, use_errno=True)


def _why(error: Exception) -> str:
    return error.strerror or str(error) if isinstance(error, OSError) else "this system has none"
