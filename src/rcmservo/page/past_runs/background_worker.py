"""Execution of work on records in a process of low priority.

Neither the page nor the servo waits for it.
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
"""Longest time in s for a piece of work."""

MAX_QUEUED = 4
"""Largest number of pieces of work, including the running one."""

NICENESS = 15
"""Niceness of the process."""

Result = TypeVar("Result")


class BackgroundWorker:
    """Executor of one piece of work at a time."""

    def __init__(self) -> None:
        self._lock, self._count = Lock(), 0

    @property
    def is_full(self) -> bool:
        """State in which no further work is accepted."""
        return self._count >= MAX_QUEUED

    def run(self, work: Callable[..., Result], *arguments: Any) -> Result:
        """Run a module's function in another process and return its result. This call blocks.

        Raises
        ------
        RcmServoError
            If the function raises one, takes too long, or its process ends.
        """
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
        raise RcmServoError("the process that reads records has ended unexpectedly")
    answer = pickle.loads(process.stdout)
    if isinstance(answer, RcmServoError):
        raise answer
    return answer


def main() -> None:
    """Read a piece of work from standard input, run it, and write the result to standard output."""
    os.nice(NICENESS)
    work, arguments = pickle.load(sys.stdin.buffer)
    try:
        answer: object = work(*arguments)
    except RcmServoError as error:
        answer = RcmServoError(str(error))
    sys.stdout.buffer.write(pickle.dumps(answer))
