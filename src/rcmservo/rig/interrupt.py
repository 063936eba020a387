"""Ctrl-C that takes effect between two ticks, so that no message of a record is cut in half."""

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager


@contextmanager
def deferred_interrupt() -> Generator[Callable[[], None]]:
    """Yield a function that raises KeyboardInterrupt if Ctrl-C was pressed.

    Threads other than the main one cannot receive Ctrl-C.
    """
    is_interrupted = False

    def note_interrupt(signal_number: int, frame: object) -> None:
        nonlocal is_interrupted
        is_interrupted = True

    def raise_if_interrupted() -> None:
        if is_interrupted:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield raise_if_interrupted
        return
    previous_handler = signal.signal(signal.SIGINT, note_interrupt)
    try:
        yield raise_if_interrupted
    finally:
        signal.signal(signal.SIGINT, previous_handler)
