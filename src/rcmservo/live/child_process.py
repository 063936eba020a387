"""Child process with a pipe to its parent, which requests its orderly end."""

import contextlib
import signal
import threading
from collections.abc import Callable, Generator
from multiprocessing.context import ForkServerContext, SpawnContext
from typing import Any

from rcmservo.errors import RcmServoError
from rcmservo.live.realtime import without_huge_pages

Context = SpawnContext | ForkServerContext
"""Start methods of processes. A plain fork is excluded: it copies threads that hold locks."""

EXIT_TIMEOUT_S = 3.0
"""Time in s within which a process must exit after a request to end."""


class ChildProcess:
    """Process that runs a function with one end of a pipe, and the other end of that pipe.

    Parameters
    ----------
    context : Context
        Start method.
    work : Callable
        Function that the process runs. Its last argument is the child's end of the pipe.
    *arguments
        Other arguments of the function.
    """

    def __init__(self, context: Context, work: Callable[..., None], *arguments: Any) -> None:
        self.pipe, child_end = context.Pipe()
        self.process = context.Process(target=work, args=(*arguments, child_end), daemon=True)
        with _ignore_interrupts(), without_huge_pages():
            self.process.start()
        child_end.close()

    def receive(self) -> Any:
        """Return the next message of the process.

        Raises
        ------
        RcmServoError
            If the process sent an error, or ended.
        """
        try:
            message = self.pipe.recv()
        except (EOFError, OSError) as error:
            self.process.join(EXIT_TIMEOUT_S)
            raise RcmServoError(f"a process ended by itself: {self.process.name}") from error
        if isinstance(message, RcmServoError):
            raise message
        return message

    def send(self, message: object) -> None:
        """Send a message. It is lost if the process has ended."""
        with contextlib.suppress(OSError):
            self.pipe.send(message)

    def end(self) -> None:
        """Ask the process to end, and kill it after a time-out."""
        self.send("end")
        self.process.join(EXIT_TIMEOUT_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.pipe.close()


@contextlib.contextmanager
def _ignore_interrupts() -> Generator[None]:
    """Ignore Ctrl-C in processes that are started inside: their parent ends them in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former_handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, former_handler)


def receive_from_parent(pipe: Any) -> Any:
    """Return the next message of the parent process, or "end" if the parent is gone."""
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return "end"
