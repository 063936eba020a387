"""Real-time settings of a process that moves an arm, so that nothing delays its loop for long.

Python's garbage collector can pause a large program for 0.1 s. It is off while an arm moves, and
objects made before are excluded from collection. Another Python thread could hold the interpreter's
lock for 5 ms, so the switch interval is shortened. The operating system gives this thread a
real-time priority and keeps its memory in RAM.

The other threads of the process have the next lower priority, above all other work of the computer:
a thread that holds the interpreter's lock while it waits for a processor delays the loop too. A
thread that sends commands to a device requests a priority above theirs: `request_urgent_priority`.

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
"""Real-time priority of the loop (1 to 99): above ordinary work, below the device threads of the
kernel."""

OTHER_PRIORITY = 10
"""Real-time priority of the other threads."""

URGENT_PRIORITY = 15
"""Real-time priority of a thread that sends the loop's commands to a device."""

REFUSED = "real-time scheduling was refused"

LOCK_CURRENT_PAGES, LOCK_ON_FIRST_USE = 1, 4
"""Flags MCL_CURRENT and MCL_ONFAULT of the system call mlockall."""

SET_NO_HUGE_PAGES, GET_NO_HUGE_PAGES = 41, 42
"""Commands PR_SET_THP_DISABLE and PR_GET_THP_DISABLE of the system call prctl."""


@dataclass
class Realtime:
    """Results of the requests to the operating system.

    Parameters
    ----------
    refused : list[str]
        One sentence for each refused request.
    collections : int
        Number of garbage collections that paused the process nevertheless.
    """

    refused: list[str] = field(default_factory=list[str])
    collections: int = 0

    def _count_collection(self, stage: str, info: object) -> None:
        """Count a collection; the garbage collector calls it at the start and end of each."""
        self.collections += stage == "start"


@contextmanager
def apply_realtime_settings() -> Generator[Realtime]:
    """Give the calling thread the first priority, and the existing threads the next one.

    The priorities hold while the context is open. Threads that are started inside keep the ordinary
    priority.
    """
    results = Realtime()
    switch_interval, was_collecting = sys.getswitchinterval(), gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    gc.callbacks.append(results._count_collection)  # pyright: ignore[reportPrivateUsage]
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    former_scheduling = _raise_priorities(results)
    is_locked = _lock_memory(results)
    try:
        with without_huge_pages():
            yield results
    finally:
        if is_locked:
            _load_c_library().munlockall()
        for thread_id, policy, priority in former_scheduling:
            with suppress(ProcessLookupError):  # the thread has ended
                _schedule(thread_id, policy, priority)
        sys.setswitchinterval(switch_interval)
        gc.callbacks.remove(results._count_collection)  # pyright: ignore[reportPrivateUsage]
        gc.unfreeze()
        if was_collecting:
            gc.enable()


@contextmanager
def without_huge_pages() -> Generator[None]:
    """Disable huge pages for this process while the context is open.

    Processes that are started inside never use them. On systems other than Linux nothing changes.
    """
    c_library: Any = ctypes.CDLL(None)
    if not hasattr(c_library, "prctl"):
        yield
        return
    was_disabled = c_library.prctl(GET_NO_HUGE_PAGES, 0, 0, 0, 0)
    c_library.prctl(SET_NO_HUGE_PAGES, 1, 0, 0, 0)
    try:
        yield
    finally:
        c_library.prctl(SET_NO_HUGE_PAGES, max(was_disabled, 0), 0, 0, 0)


def request_urgent_priority() -> str:
    """Give the calling thread a priority just below that of the loop, until it ends.

    Returns
    -------
    str
        Reason for which the system refused, in a sentence, which is logged too; empty if it agreed.
    """
    try:
        _schedule(threading.get_native_id(), os.SCHED_FIFO, URGENT_PRIORITY)
    except (AttributeError, OSError) as error:
        refusal = f"{REFUSED} ({_describe(error)}): other work may delay what goes to the device"
        logging.getLogger(__name__).info(refusal)
        return refusal
    return ""


def _raise_priorities(results: Realtime) -> list[tuple[int, int, int]]:
    """Request real-time scheduling of all threads.

    Return id, former policy and former priority of each thread that was changed.
    """
    loop_thread = threading.get_native_id()
    threads = [loop_thread, *(thread.native_id for thread in threading.enumerate())]
    former_scheduling: list[tuple[int, int, int]] = []
    try:
        for thread_id in filter(None, dict.fromkeys(threads)):
            policy = os.sched_getscheduler(thread_id)
            priority = os.sched_getparam(thread_id).sched_priority
            is_loop = thread_id == loop_thread
            if priority > OTHER_PRIORITY and not is_loop:
                continue  # an urgent thread keeps its own priority
            new_priority = LOOP_PRIORITY if is_loop else OTHER_PRIORITY
            _schedule(thread_id, os.SCHED_FIFO, new_priority)
            former_scheduling.append((thread_id, policy, priority))
    except (AttributeError, OSError) as error:
        results.refused.append(f"{REFUSED} ({_describe(error)}): other work may delay the loop")
    return former_scheduling


def _schedule(thread_id: int, policy: int, priority: int) -> None:
    """Set a thread's scheduling, which threads that it starts do not inherit."""
    os.sched_setscheduler(thread_id, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _lock_memory(results: Realtime) -> bool:
    """Lock the memory of the process in RAM; return False if the system refuses."""
    try:
        if _load_c_library().mlockall(LOCK_CURRENT_PAGES | LOCK_ON_FIRST_USE) == 0:
            return True
        reason = os.strerror(ctypes.get_errno())
    except (AttributeError, OSError) as error:
        reason = _describe(error)
    results.refused.append(f"locking memory was refused ({reason}): paging may delay the loop")
    return False


def _load_c_library() -> Any:
    return ctypes.CDLL(None, use_errno=True)


def _describe(error: Exception) -> str:
    return error.strerror or str(error) if isinstance(error, OSError) else "this system has none"
