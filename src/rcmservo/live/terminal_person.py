"""The person at the terminal that a program was started from.

The terminal itself is asked (/dev/tty), never the standard input, so that no file and no other
program's output can answer. What was typed before a question is thrown away, and each answer comes
with the time before which it was not typed.
"""

import os
import select
import termios
import time
from collections.abc import Callable
from pathlib import Path

from rcmservo.errors import Stopped
from rcmservo.live.lab import NotReady

TERMINAL = Path("/dev/tty")
"""The terminal of whoever opens it."""

LOOK = 0.1
"""s between two looks whether the program was told to end."""

LINE = 4096
"""Bytes that a terminal hands over at most of one line."""


class Terminal:
    """A person at this program's terminal; `close` it at the end."""

    def __init__(self, told_to_end: Callable[[], bool] = lambda: False) -> None:
        self.typed = 0
        """ns of the wall clock: the last answer was not typed before."""
        self._told_to_end = told_to_end
        try:
            self._file = os.open(TERMINAL, os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
        except OSError as error:
            raise NotReady(
                "hardware is enabled only by a person at a terminal, and this program has none"
            ) from error

    def close(self) -> None:
        os.close(self._file)

    def tell(self, words: str) -> None:
        """Say something that needs no answer."""
        self._write(f"{words}\n")

    def ask(self, question: str) -> str:
        """What the person answers to this question. :class:`Stopped` by Ctrl-D, where the terminal
        is gone, and where the program is told to end."""
        self._forget_typed()
        self._write(f"{question} ")
        return self._line()

    def _forget_typed(self) -> None:
        """Throw away what was typed, and what a script goes on to type at once."""
        if os.tcgetpgrp(self._file) != os.getpgrp():
            raise NotReady(
                "this program runs in the background: a person must bring it to the front"
            )
        termios.tcflush(self._file, termios.TCIFLUSH)
        if self._told_to_end():
            raise Stopped("stopped before the drive was on")
        select.select([], [], [], LOOK)
        self.typed = time.monotonic_ns()
        termios.tcflush(self._file, termios.TCIFLUSH)

    def _line(self) -> str:
        """The next line. Nothing waited when a look that found nothing began: however long this
        process is kept from looking, ``typed`` is not too late."""
        began = self.typed
        while not select.select([self._file], [], [], LOOK)[0]:
            if self._told_to_end():
                raise Stopped("stopped before the drive was on")
            self.typed, began = began, time.monotonic_ns()
        line = self._read()
        if not line.endswith(b"\n"):
            raise Stopped("ended at the terminal, before the drive was on")
        return line.decode(errors="replace").strip()

    def _read(self) -> bytes:
        """A whole line, or what there is of one that is ended by Ctrl-D; nothing where the terminal
        is gone."""
        try:
            return os.read(self._file, LINE)
        except OSError:
            return b""

    def _write(self, words: str) -> None:
        data = words.encode(errors="replace")
        try:
            while data:
                data = data[os.write(self._file, data) :]
        except OSError as error:
            raise Stopped("the terminal is gone") from error
