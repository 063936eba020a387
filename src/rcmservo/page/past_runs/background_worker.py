"""Execution of functions that read records in processes of low priority.

The page stays responsive and the servo keeps its share of the processor meanwhile.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from threading import Lock
from typing import Any, TypeVar

from rcmservo.errors import RcmServoError

MAX_CALL_S = 300.0
"""Longest time in s for a call."""

MAX_QUEUED_CALLS = 4
"""Largest number of calls, including the running one."""

NICENESS = 15
"""Niceness of the process, the POSIX measure of low priority."""

Result = TypeVar("Result")


class BackgroundWorker:
    """Executor of one call at a time, each in a process of its own."""

    def __init__(self) -> None:
        self._lock, self._count = Lock(), 0

    @property
    def is_full(self) -> bool:
        """True if the queue of calls is full."""
        return self._count >= MAX_QUEUED_CALLS

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Call a module's function in another process and return its result. This call blocks.

        Raises
        ------
        RcmServoError
            If the function raises one, takes too long, or its process ends.
        """
        self._count += 1
        try:
            with self._lock:
                return _run_in_process(pickle.dumps((function, arguments)))
        finally:
            self._count -= 1


def _run_in_process(pickled_call: bytes) -> Any:
    command = [sys.executable, "-c", f"from {__name__} import main; main()"]
    try:
        process = subprocess.run(
            command,
            input=pickled_call,
            stdout=subprocess.PIPE,
            timeout=MAX_CALL_S,
            start_new_session=True,
            check=True,
        )
    except subprocess.TimeoutExpired as error:
        raise RcmServoError(f"the record took longer than {MAX_CALL_S:g} s to read") from error
    except subprocess.CalledProcessError as error:
        raise RcmServoError("the process that reads records has ended unexpectedly") from error
    result = pickle.loads(process.stdout)
    if isinstance(result, RcmServoError):
        raise result
    return result


def main() -> None:
    """Read a pickled call from standard input, make it, and pickle the result to standard output.

    An `RcmServoError` of the function is a result too.
    """
    os.nice(NICENESS)
    function, arguments = pickle.load(sys.stdin.buffer)
    try:
        result: object = function(*arguments)
    except RcmServoError as error:
        result = RcmServoError(str(error))
    sys.stdout.buffer.write(pickle.dumps(result))
