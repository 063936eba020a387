"""Requests to end a process in order.

A signal only sets a flag, so the process completes its present work first. The supervisor requests
the end through its pipe, or by closing it. A closed terminal sends a signal.
"""

import contextlib
import signal
import threading
from collections.abc import Generator
from multiprocessing.connection import Connection

from rcmservo.errors import Stopped

END_SIGNALS = (signal.SIGTERM, signal.SIGHUP)
"""Signals that request an orderly end. A terminal that is closed sends the second."""


class EndRequest:
    """Request to end the servo process, from its supervisor or by a signal.

    The supervisor handles Ctrl-C.

    Parameters
    ----------
    supervisor : Connection
        Pipe to the supervisor.
    """

    def __init__(self, supervisor: Connection) -> None:
        self.signal = ""
        """Name of the received signal; empty before the first."""
        self._supervisor = supervisor

    def handle_signals(self) -> None:
        """Handle signals from now on. Call it in the main thread of a separate process."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for number in END_SIGNALS:
            signal.signal(number, self._note)

    def __call__(self) -> bool:
        return bool(self.signal) or self._supervisor.poll()

    def _note(self, number: int, frame: object) -> None:
        self.signal = signal.Signals(number).name


@contextlib.contextmanager
def stopped_by_signals() -> Generator[None]:
    """Raise :class:`Stopped` inside the context at the first stop signal, and ignore further ones.

    Nothing then interrupts the orderly end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = {number: signal.getsignal(number) for number in END_SIGNALS}

    def stop(number: int, frame: object) -> None:
        for other in END_SIGNALS:
            signal.signal(other, signal.SIG_IGN)
        raise Stopped(f"stopped by {signal.Signals(number).name}, in order")

    for number, before in usual.items():
        if before is not signal.SIG_IGN:  # nohup: the program survives its terminal
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, before in usual.items():
            signal.signal(number, before)
