"""A program in the controller's memory: lines of commands, and labels at which threads begin.

Source: command reference, DL, labels and XQ; motorapp/Galil, programValidate and programDownload.
"""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

from rcmservo.hardware.galil.emulator.numbers import Refusal

LINES = 2000
"""Lines of a program at most."""
WIDTH = 80
"""Characters of a line at most."""

LABEL = re.compile(r"#([A-Za-z][A-Za-z0-9]{0,6})$")


class Instruction(NamedTuple):
    """One command of a program."""

    line: int
    """The line that it stands in, counted from 0."""
    text: str
    """The command."""


def commands_of(line: str) -> list[str]:
    """What stands between the semicolons of a line, those in quotes left alone."""
    return [part.strip() for part in re.split(r';(?=(?:[^"]*"[^"]*")*[^"]*$)', line)]


@dataclass
class Program:
    """A program, line after line."""

    lines: list[str] = field(default_factory=list[str])
    """As they were sent."""
    instructions: list[Instruction] = field(default_factory=list[Instruction])
    """The commands in them."""
    labels: dict[str, int] = field(default_factory=dict[str, int])
    """Of every label, the instruction behind it."""

    def add(self, line: str) -> None:
        """One more line, or Refusal."""
        if len(line) > WIDTH or len(self.lines) == LINES:
            raise Refusal(60)
        number = len(self.lines)
        self.lines.append(line)
        for i, text in enumerate(commands_of(line)):
            if text.startswith("#"):
                self._add_label(text, i)
            elif text and not text.startswith(("'", "REM")):
                self.instructions.append(Instruction(number, text))
            if text.startswith(("'", "REM")):
                return

    def _add_label(self, text: str, place: int) -> None:
        match = LABEL.match(text)
        if match is None or place or match.group(1) in self.labels:
            raise Refusal(61)
        self.labels[match.group(1)] = len(self.instructions)

    def at(self, label: str) -> int:
        """The instruction at a label, or Refusal."""
        if label not in self.labels:
            raise Refusal(10)
        return self.labels[label]

    def at_line(self, line: int) -> int:
        """The first instruction from a line on, or Refusal."""
        if not 0 <= line < len(self.lines):
            raise Refusal(11)
        behind = (i for i, one in enumerate(self.instructions) if one.line >= line)
        return next(behind, len(self.instructions))

    def behind(self, at: int, ends: tuple[str, ...]) -> int:
        """The instruction behind the first of `ends` that belongs to the IF whose branch begins at
        `at`."""
        depth = 0
        for i in range(at, len(self.instructions)):
            word = self.instructions[i].text.split("(")[0].strip()
            if depth == 0 and word in ends:
                return i + 1
            depth += (word == "IF" or word.startswith("IF ")) - (word == "ENDIF")
        raise Refusal(63)
