"""A process that this one has started: it says things, and ends when it is told to."""

import contextlib
import signal
import threading
from collections.abc import Callable, Generator
from multiprocessing.context import ForkServerContext, SpawnContext
from typing import Any

from rcmservo.errors import RcmServoError
from rcmservo.live.realtime import without_huge_pages

Context = SpawnContext | ForkServerContext
"""How processes are started: never by a plain fork, which would copy threads that hold locks."""

END = 3.0
"""s within which a process ends that is told to."""


class Child:
    """A process that this one started, and the wire to it. It ends when it is told to, and is
    killed if it does not."""

    def __init__(self, context: Context, work: Callable[..., None], *arguments: Any) -> None:
        self.wire, its = context.Pipe()
        self.process = context.Process(target=work, args=(*arguments, its), daemon=True)
        with _ctrl_c_left_to_us(), without_huge_pages():
            self.process.start()
        its.close()

    def hear(self) -> Any:
        """The next thing it says; what it could not do is raised."""
        try:
            said = self.wire.recv()
        except (EOFError, OSError) as error:
            self.process.join(END)
            raise RcmServoError(f"a process ended by itself: {self.process.name}") from error
        if isinstance(said, RcmServoError):
            raise said
        return said

    def tell(self, word: object) -> None:
        with contextlib.suppress(OSError):
            self.wire.send(word)

    def end(self) -> None:
        """Tell it to end, or kill it."""
        self.tell("end")
        self.process.join(END)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.wire.close()


@contextlib.contextmanager
def _ctrl_c_left_to_us() -> Generator[None]:
    """Processes started in here do not end by Ctrl-C: they are ended in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)


def heard(wire: Any) -> Any:
    """What the other end of a wire says; "end" where it is gone."""
    try:
        return wire.recv()
    except (EOFError, OSError):
        return "end"
