"""Whether a process was told to end.

A signal changes a note and nothing else: what the process is about is finished first. The
supervisor speaks by its wire, or is gone; a terminal that is closed speaks by a signal.
"""

import contextlib
import signal
import threading
from collections.abc import Generator
from multiprocessing.connection import Connection

from rcmservo.errors import Stopped

ORDERLY = (signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a program to end in order. The second comes of a terminal that is closed."""


class ToldToEnd:
    """Whether the servo process was told to end, by its supervisor or by a signal. Ctrl-C is its
    supervisor's."""

    def __init__(self, supervisor: Connection) -> None:
        self.signal = ""
        """The name of the signal that told it; empty while none has."""
        self._supervisor = supervisor

    def heed(self) -> None:
        """From now on signals are noted: in the main thread of a process of its own."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for number in ORDERLY:
            signal.signal(number, self._note)

    def __call__(self) -> bool:
        return bool(self.signal) or self._supervisor.poll()

    def _note(self, number: int, frame: object) -> None:
        self.signal = signal.Signals(number).name


@contextlib.contextmanager
def stopped_by_signals() -> Generator[None]:
    """The first orderly signal raises :class:`Stopped` in here, and the others nothing any more:
    what is ended in order is not interrupted by being told so again."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = {number: signal.getsignal(number) for number in ORDERLY}

    def stop(number: int, frame: object) -> None:
        for other in ORDERLY:
            signal.signal(other, signal.SIG_IGN)
        raise Stopped(f"stopped by {signal.Signals(number).name}, in order")

    for number, before in usual.items():
        if before is not signal.SIG_IGN:  # as of a program that goes on without its terminal
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, before in usual.items():
            signal.signal(number, before)
