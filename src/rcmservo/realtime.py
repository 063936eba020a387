"""What a process asks of the computer while it moves an arm: that nothing interrupts it for long.

Python's garbage collector pauses a large program for 0.1 s: while an arm moves it is off, and what was there before is
not looked at again. A Python thread that works beside the loop would keep it waiting for 5 ms: the interpreter is told
to switch sooner. The operating system is asked to let this thread go first and to keep its memory at hand.
"""

import ctypes
import gc
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

SWITCH = 0.0005
"""s after which a thread beside the loop must let it go on."""

PRIORITY = 20
"""Of 1 to 99: above all ordinary work, below what the kernel does for its devices."""

CURRENT, ON_FAULT = 1, 4
"""mlockall: what is in memory stays there, and what comes to be used stays too."""


@dataclass
class Realtime:
    """What became of it: ``refused``, one sentence for each thing that was asked of the system and refused, and how
    often ``collections`` of garbage stopped the process nevertheless."""

    refused: list[str] = field(default_factory=list[str])
    collections: int = 0

    def _count(self, moment: str, about: object) -> None:
        self.collections += moment == "start"


@contextmanager
def realtime() -> Generator[Realtime]:
    """Make the calling thread the one that goes first, for as long as the context is open.

    Threads that are started before or in it keep the ordinary priority.
    """
    got = Realtime()
    interval, collecting = sys.getswitchinterval(), gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    gc.callbacks.append(got._count)  # pyright: ignore[reportPrivateUsage]
    sys.setswitchinterval(SWITCH)
    before = _first(got)
    locked = _locked(got)
    try:
        yield got
    finally:
        if locked:
            _system().munlockall()
        if before is not None:
            _schedule(*before)
        sys.setswitchinterval(interval)
        gc.callbacks.remove(got._count)  # pyright: ignore[reportPrivateUsage]
        gc.unfreeze()
        if collecting:
            gc.enable()


def _first(got: Realtime) -> tuple[int, int] | None:
    """Ask for real-time scheduling; the policy and priority to go back to, or None where it was refused."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
        _schedule(os.SCHED_FIFO, PRIORITY)
    except (AttributeError, OSError) as error:
        got.refused.append(f"real-time scheduling was refused ({_why(error)}): other work may delay the loop")
        return None
    return before


def _schedule(policy: int, priority: int) -> None:
    """Threads that this one starts do not inherit its priority."""
    os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


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
