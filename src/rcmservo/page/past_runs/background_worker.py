"""Work on a record, in a process of its own that gives way to all others: neither the page nor the
servo waits for it.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from threading import Lock
from typing import Any, TypeVar

from rcmservo.errors import RcmServoError

LONGEST = 300.0
"""s that a piece of work may take."""

WAITING = 4
"""Pieces of work that there may be, with the one that is done now."""

GIVES_WAY = 15
"""Of the process's niceness."""

Made = TypeVar("Made")


class Aside:
    """Does one piece of work after the other."""

    def __init__(self) -> None:
        self._one, self._count = Lock(), 0

    @property
    def full(self) -> bool:
        """Whether no more work is taken."""
        return self._count >= WAITING

    def do(self, work: Callable[..., Made], *given: Any) -> Made:
        """What a function of a module makes; what it could not do is raised. It blocks."""
        self._count += 1
        try:
            with self._one:
                return _done(pickle.dumps((work, given)))
        finally:
            self._count -= 1


def _done(job: bytes) -> Any:
    command = [sys.executable, "-c", f"from {__name__} import main; main()"]
    try:
        made = subprocess.run(
            command,
            input=job,
            stdout=subprocess.PIPE,
            timeout=LONGEST,
            start_new_session=True,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise RcmServoError(f"the record took longer than {LONGEST:g} s to read") from error
    if made.returncode:
        raise RcmServoError("the process that reads records has ended by itself")
    answer = pickle.loads(made.stdout)
    if isinstance(answer, RcmServoError):
        raise answer
    return answer


def main() -> None:
    """Do the work that stands in the input, and write what it makes."""
    os.nice(GIVES_WAY)
    work, given = pickle.load(sys.stdin.buffer)
    try:
        answer: object = work(*given)
    except RcmServoError as error:
        answer = RcmServoError(str(error))
    sys.stdout.buffer.write(pickle.dumps(answer))
