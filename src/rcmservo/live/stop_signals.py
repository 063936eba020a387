"""Requests for the orderly end of a process, by a signal or by its supervisor.

In the servo process, `EndRequest` stores a signal, and the process completes its present work. The
supervisor requests the end through its pipe, or by closing it. In a command, `stopped_by_signals`
raises an error at once.
"""

import contextlib
import signal
import threading
from collections.abc import Generator
from multiprocessing.connection import Connection

from rcmservo.errors import Stopped

END_SIGNALS = (signal.SIGTERM, signal.SIGHUP)
"""Signals that request an orderly end. A terminal sends SIGHUP when it is closed."""


class EndRequest:
    """Request to end the servo process, from its supervisor or by a signal.

    Called without arguments, it returns True once the end is requested. It ignores Ctrl-C, since
    the supervisor handles that.

    Parameters
    ----------
    supervisor : Connection
        Pipe to the supervisor.
    """

    def __init__(self, supervisor: Connection) -> None:
        self.signal = ""
        """Name of the received signal; empty before the first."""
        self._supervisor = supervisor

    def install_handlers(self) -> None:
        """Handle signals from now on. Call it in the main thread of a separate process."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for number in END_SIGNALS:
            signal.signal(number, self._store_signal)

    def __call__(self) -> bool:
        return bool(self.signal) or self._supervisor.poll()

    def _store_signal(self, number: int, frame: object) -> None:
        self.signal = signal.Signals(number).name


@contextlib.contextmanager
def stopped_by_signals() -> Generator[None]:
    """Raise `Stopped` inside the context at the first of the `END_SIGNALS`.

    Further ones are ignored until the end of the context, so that they interrupt no cleanup in it.
    Outside the main thread, which alone can handle signals, nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former_handlers = {number: signal.getsignal(number) for number in END_SIGNALS}

    def stop(received: int, frame: object) -> None:
        for number in END_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        raise Stopped(f"stopped by {signal.Signals(received).name}, in order")

    for number, handler in former_handlers.items():
        if handler is not signal.SIG_IGN:  # nohup: the program survives its terminal
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in former_handlers.items():
            signal.signal(number, handler)
