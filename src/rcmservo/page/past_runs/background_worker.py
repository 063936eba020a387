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

MAX_WORK_S = 300.0
"""s that a piece of work may take."""

MAX_QUEUED = 4
"""Pieces of work that there may be, with the one that is done now."""

NICENESS = 15
"""Of the process's niceness."""

Result = TypeVar("Result")


class BackgroundWorker:
    """Does one piece of work after the other."""

    def __init__(self) -> None:
        self._lock, self._count = Lock(), 0

    @property
    def is_full(self) -> bool:
        """Whether no more work is taken."""
        return self._count >= MAX_QUEUED

    def run(self, work: Callable[..., Result], *arguments: Any) -> Result:
        """What a function of a module makes; what it could not do is raised. It blocks."""
        self._count += 1
        try:
            with self._lock:
                return _run_in_process(pickle.dumps((work, arguments)))
        finally:
            self._count -= 1


def _run_in_process(job: bytes) -> Any:
    command = [sys.executable, "-c", f"from {__name__} import main; main()"]
    try:
        process = subprocess.run(
            command,
            input=job,
            stdout=subprocess.PIPE,
            timeout=MAX_WORK_S,
            start_new_session=True,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise RcmServoError(f"the record took longer than {MAX_WORK_S:g} s to read") from error
    if process.returncode:
        raise RcmServoError("the process that reads records has ended by itself")
    answer = pickle.loads(process.stdout)
    if isinstance(answer, RcmServoError):
        raise answer
    return answer


def main() -> None:
    """Do the work that stands in the input, and write what it makes."""
    os.nice(NICENESS)
    work, arguments = pickle.load(sys.stdin.buffer)
    try:
        answer: object = work(*arguments)
    except RcmServoError as error:
        answer = RcmServoError(str(error))
    sys.stdout.buffer.write(pickle.dumps(answer))
