"""Questions to the person at the arm, asked again until the answer can be one."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from rcmservo.errors import Stopped
from rcmservo.live.lab import Person

Answer = TypeVar("Answer")

TIMES = 5
"""So often a question is asked before it ends."""
UNKNOWN = "unknown"
"""Answered where nobody can measure it."""
LONG = 2000.0
"""mm, the longest that is measured by a ruler."""


def one_of(person: Person, question: str, words: Sequence[str]) -> str:
    """The one of these words that the person answers."""
    choice = " / ".join(words)

    def read(answer: str) -> str | None:
        return answer.lower() if answer.lower() in words else None

    return _understood(person, f"{question} ({choice})", read, f"one of these: {choice}")


def agreed(person: Person, question: str) -> None:
    """The person says yes; :class:`Stopped` otherwise."""
    if one_of(person, question, ("yes", "no")) == "no":
        raise Stopped(f"the answer was no to: {question}")


def by_ruler(person: Person, question: str, least: float) -> float | None:
    """What a ruler shows, mm, `least` at least; None where the person cannot tell."""

    def read(answer: str) -> tuple[float | None] | None:
        if answer.lower() == UNKNOWN:
            return (None,)
        try:
            mm = float(answer)
        except ValueError:
            return None
        return (mm,) if least <= mm <= LONG else None

    wanted = f"a number of mm from {least:g} to {LONG:g}, or {UNKNOWN}"
    return _understood(person, f"{question} (or: {UNKNOWN})", read, wanted)[0]


def _understood(
    person: Person, question: str, read: Callable[[str], Answer | None], right: str
) -> Answer:
    for _ in range(TIMES):
        answer = read(person.ask(question))
        if answer is not None:
            return answer
        person.tell(f"Please answer with {right}.")
    raise Stopped(f"no answer was understood to: {question}")
