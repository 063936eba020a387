"""Program in the controller's memory: lines of commands, with labels where threads can start.

Sources: command reference, DL, labels and XQ; motorapp/Galil, programValidate and programDownload.
"""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

from rcmservo.hardware.galil.connection import MAX_LINE_LENGTH
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode

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
            raise CommandError(ErrorCode.DOWNLOAD_TOO_LONG)
        line_number = len(self.lines)
        self.lines.append(line)
        for index_in_line, text in enumerate(_split_line(line)):
            if text.startswith(("'", "REM")):  # a comment, up to the end of the line
                return
            if text.startswith("#"):
                self._add_label(text, index_in_line)
            elif text:
                self.instructions.append(Instruction(line_number, text))

    def _add_label(self, text: str, index_in_line: int) -> None:
        match = LABEL_PATTERN.match(text)
        if match is None or index_in_line or match.group(1) in self.labels:
            raise CommandError(ErrorCode.BAD_LABEL)
        self.labels[match.group(1)] = len(self.instructions)

    def index_of_label(self, label: str) -> int:
        """Return the index of the instruction after a label, or raise :class:`CommandError`."""
        if label not in self.labels:
            raise CommandError(ErrorCode.UNDEFINED_LABEL)
        return self.labels[label]

    def index_of_line(self, line: int) -> int:
        """Return the index of the first instruction in a line or after it.

        Raise :class:`CommandError` if the program has no such line.
        """
        if not 0 <= line < len(self.lines):
            raise CommandError(ErrorCode.INVALID_LINE_NUMBER)
        return sum(instruction.line < line for instruction in self.instructions)

    def index_after(self, start: int, ends: tuple[str, ...]) -> int:
        """Return the index after the end of an IF branch that begins at `start`.

        The end is the first of the commands `ends` that does not belong to a nested IF.
        """
        depth = 0
        for index in range(start, len(self.instructions)):
            name = self.instructions[index].text.split("(")[0].strip()
            if depth == 0 and name in ends:
                return index + 1
            depth += (name == "IF" or name.startswith("IF ")) - (name == "ENDIF")
        raise CommandError(ErrorCode.MISSING_ENDIF)


def _split_line(line: str) -> list[str]:
    """Split a line at its semicolons, except for those in quotes."""
    return [part.strip() for part in re.split(r';(?=(?:[^"]*"[^"]*")*[^"]*$)', line)]
