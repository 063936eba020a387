"""Operator at the terminal from which the program was started.

Questions go to the terminal itself (/dev/tty), never to the standard input, so that no file and no
other program's output can answer. Input typed before a question is discarded, and each answer comes
with the earliest time at which it can have been typed.
"""

import os
import select
import termios
import time
from collections.abc import Callable
from pathlib import Path

from rcmservo.errors import Stopped
from rcmservo.live.device_protocols import NotReady

TERMINAL = Path("/dev/tty")
"""Path at which every process finds its own terminal."""

STOP_POLL_S = 0.1
"""Interval in s at which a request to end the program is polled."""

MAX_LINE_BYTES = 4096
"""Longest line in bytes that a terminal returns."""


class Terminal:
    """Operator at this program's terminal. Close it at the end.

    Parameters
    ----------
    stop_requested : Callable
        Function that returns True once the program must end.

    Raises
    ------
    NotReady
        If the program has no terminal.
    """

    def __init__(self, stop_requested: Callable[[], bool] = lambda: False) -> None:
        self.typed = 0
        """Earliest time (ns of the wall clock) at which the last answer can have been typed."""
        self._stop_requested = stop_requested
        try:
            self._file = os.open(TERMINAL, os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
        except OSError as error:
            raise NotReady(
                "hardware is enabled only by an operator at a terminal, and this program has none"
            ) from error

    def close(self) -> None:
        os.close(self._file)

    def notify(self, message: str) -> None:
        """Print a text that needs no answer."""
        self._write(f"{message}\n")

    def ask(self, question: str) -> str:
        """Return the operator's answer to a question.

        Raises
        ------
        Stopped
            After Ctrl-D, if the terminal is closed, or if the program must end.
        NotReady
            If the program runs in the background.
        """
        self._discard_input()
        self._write(f"{question} ")
        return self._read_line()

    def _discard_input(self) -> None:
        """Discard input that was typed before, and input that a script types at once."""
        if os.tcgetpgrp(self._file) != os.getpgrp():
            raise NotReady("this program runs in the background: bring it to the foreground (fg)")
        termios.tcflush(self._file, termios.TCIFLUSH)
        if self._stop_requested():
            raise Stopped("stopped before the drive was on")
        select.select([], [], [], STOP_POLL_S)
        self.typed = time.monotonic_ns()
        termios.tcflush(self._file, termios.TCIFLUSH)

    def _read_line(self) -> str:
        """Return the next line.

        A poll that finds no input proves that nothing was typed before the poll began. ``typed`` is
        therefore never too late, however long the process was suspended.
        """
        poll_began_ns = self.typed
        while not select.select([self._file], [], [], STOP_POLL_S)[0]:
            if self._stop_requested():
                raise Stopped("stopped before the drive was on")
            self.typed, poll_began_ns = poll_began_ns, time.monotonic_ns()
        try:
            line = os.read(self._file, MAX_LINE_BYTES)
        except OSError:  # the terminal is closed
            line = b""
        if not line.endswith(b"\n"):  # Ctrl-D ends a line without it
            raise Stopped("stopped at the terminal before the drive was on")
        return line.decode(errors="replace").strip()

    def _write(self, text: str) -> None:
        remaining = text.encode(errors="replace")
        try:
            while remaining:
                remaining = remaining[os.write(self._file, remaining) :]
        except OSError as error:
            raise Stopped("the terminal was closed") from error
