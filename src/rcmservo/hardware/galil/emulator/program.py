"""Program in the controller's memory: lines of commands, with labels where threads can start.

Sources: command reference, DL, labels and XQ; motorapp/Galil, programValidate and programDownload.
"""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

from rcmservo.hardware.galil.connection import MAX_LINE_LENGTH
from rcmservo.hardware.galil.emulator.expressions import CommandError

MAX_LINES = 2000
"""Lines of a program."""

LABEL_PATTERN = re.compile(r"#([A-Za-z][A-Za-z0-9]{0,6})$")


class Instruction(NamedTuple):
    """One command of a program.

    Parameters
    ----------
    line : int
        Number of its line, counted from 0.
    text : str
        Text of the command.
    """

    line: int
    text: str


def split_line(line: str) -> list[str]:
    """Split a line at its semicolons, except for those in quotes."""
    return [part.strip() for part in re.split(r';(?=(?:[^"]*"[^"]*")*[^"]*$)', line)]


@dataclass
class Program:
    """Lines of a program, with its instructions and labels.

    Parameters
    ----------
    lines : list[str]
        Lines as received.
    instructions : list[Instruction]
        Commands of the lines.
    labels : dict[str, int]
        Index of the instruction that follows each label.
    """

    lines: list[str] = field(default_factory=list[str])
    instructions: list[Instruction] = field(default_factory=list[Instruction])
    labels: dict[str, int] = field(default_factory=dict[str, int])

    def add(self, line: str) -> None:
        """Append a line, or raise :class:`CommandError`."""
        if len(line) > MAX_LINE_LENGTH or len(self.lines) == MAX_LINES:
            raise CommandError(60)
        number = len(self.lines)
        self.lines.append(line)
        for i, text in enumerate(split_line(line)):
            if text.startswith("#"):
                self._add_label(text, i)
            elif text and not text.startswith(("'", "REM")):
                self.instructions.append(Instruction(number, text))
            if text.startswith(("'", "REM")):
                return

    def _add_label(self, text: str, index_in_line: int) -> None:
        match = LABEL_PATTERN.match(text)
        if match is None or index_in_line or match.group(1) in self.labels:
            raise CommandError(61)
        self.labels[match.group(1)] = len(self.instructions)

    def index_of_label(self, label: str) -> int:
        """Return the index of the instruction after a label, or raise :class:`CommandError`."""
        if label not in self.labels:
            raise CommandError(10)
        return self.labels[label]

    def index_of_line(self, line: int) -> int:
        """Return the index of the first instruction in a line or after it.

        Raise :class:`CommandError` if the program has no such line.
        """
        if not 0 <= line < len(self.lines):
            raise CommandError(11)
        following = (i for i, one in enumerate(self.instructions) if one.line >= line)
        return next(following, len(self.instructions))

    def index_after(self, start: int, ends: tuple[str, ...]) -> int:
        """Return the index after the end of an IF branch that begins at `start`.

        The end is the first of the commands `ends` that does not belong to a nested IF.
        """
        depth = 0
        for i in range(start, len(self.instructions)):
            word = self.instructions[i].text.split("(")[0].strip()
            if depth == 0 and word in ends:
                return i + 1
            depth += (word == "IF" or word.startswith("IF ")) - (word == "ENDIF")
        raise CommandError(63)
