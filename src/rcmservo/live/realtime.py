"""What a process asks of the computer while it moves an arm: that nothing interrupts it for long.

Python's garbage collector pauses a large program for 0.1 s: while an arm moves it is off, and what
was there before is not looked at again. A Python thread that works beside the loop would keep it
waiting for 5 ms: the interpreter is told to switch sooner. The operating system is asked to let
this thread go first, to keep its memory at hand, and to leave it as it is.

The process's other threads come next, before all other work of the computer: they share the
interpreter's lock, and one that holds it while it waits for a processor keeps the loop waiting too.
A thread that takes commands to a device asks to go before them: `urgent`.

NumPy asks that its large arrays be gathered into huge pages. Linux does that later, each 10 s, in a
thread of its own: where the kernel is not preemptible, that thread keeps a processor for 6 ms at a
time, several times in a row, whatever goes first (42 ms were measured: a controller that waits for
40 ms then stops the arm). A process that must not wait for it uses no huge pages.
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

SWITCH = 0.0005
"""s after which a thread beside the loop must let it go on."""

PRIORITY = 20
"""Of 1 to 99: above all ordinary work, below what the kernel does for its devices."""

NEXT = 10
"""That of the other threads."""

URGENT = 15
"""That of a thread which takes the loop's commands to a device."""

REFUSED = "real-time scheduling was refused"

CURRENT, ON_FAULT = 1, 4
"""mlockall: of what is mapped by then, what is in memory stays there, and what comes to be used
stays too."""

SET_NO_HUGE_PAGES, GET_NO_HUGE_PAGES = 41, 42
"""PR_SET_THP_DISABLE and PR_GET_THP_DISABLE, of prctl."""


@dataclass
class Realtime:
    """What became of it."""

    refused: list[str] = field(default_factory=list[str])
    """One sentence for each thing that was asked of the system and refused."""
    collections: int = 0
    """How often the collection of garbage stopped the process nevertheless."""

    def _count(self, moment: str, about: object) -> None:
        self.collections += moment == "start"


@contextmanager
def realtime() -> Generator[Realtime]:
    """Make the calling thread the one that goes first, and those there are next, for as long as the
    context is open.

    Threads that are started in it keep the ordinary priority.
    """
    got = Realtime()
    interval, collecting = sys.getswitchinterval(), gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    gc.callbacks.append(got._count)  # pyright: ignore[reportPrivateUsage]
    sys.setswitchinterval(SWITCH)
    before = _ahead(got)
    locked = _locked(got)
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
    """Have the kernel make no huge pages of this process's memory while the context is open, and
    never of that of processes that are started in it. Other systems do nothing."""
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
    """Have the calling thread go before all others but the loop, until it ends; why that was
    refused, in a sentence, which is noted: it works all the same."""
    try:
        _schedule(threading.get_native_id(), os.SCHED_FIFO, URGENT)
    except (AttributeError, OSError) as error:
        why = f"{REFUSED} ({_why(error)}): other work may delay what goes to the device"
        logging.getLogger(__name__).info(why)
        return why
    return ""


def _ahead(got: Realtime) -> list[tuple[int, int, int]]:
    """Ask for real-time scheduling; each thread changed, with the policy and priority to go back
    to."""
    this = threading.get_native_id()
    others = [thread.native_id for thread in threading.enumerate()]
    before: list[tuple[int, int, int]] = []
    try:
        for thread in (this, *(other for other in others if other is not None and other != this)):
            was = os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority
            if thread != this and was[1] > NEXT:
                continue  # it has asked for more itself
            _schedule(thread, os.SCHED_FIFO, PRIORITY if thread == this else NEXT)
            before.append((thread, *was))
    except (AttributeError, OSError) as error:
        got.refused.append(f"{REFUSED} ({_why(error)}): other work may delay the loop")
    return before


def _schedule(thread: int, policy: int, priority: int) -> None:
    """Threads that this one starts do not inherit its priority."""
    os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _locked(got: Realtime) -> bool:
    """Ask for memory that stays; whether it was granted."""
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
