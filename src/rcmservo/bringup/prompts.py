"""Questions to the operator at the arm, repeated until an answer is valid."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from rcmservo.errors import Stopped
from rcmservo.live.device_protocols import OperatorTerminal

Answer = TypeVar("Answer")

MAX_ATTEMPTS = 5
"""Number of times that a question is repeated before the check ends."""
UNKNOWN = "unknown"
"""Answer of an operator who cannot measure a length."""
MAX_LENGTH_MM = 2000.0
"""Largest length that is accepted as an answer."""


def ask_choice(operator: OperatorTerminal, question: str, words: Sequence[str]) -> str:
    """Return the operator's answer, one of `words`.

    Raises
    ------
    Stopped
        After `MAX_ATTEMPTS` invalid answers.
    """
    choice = " / ".join(words)

    def parse(answer: str) -> str | None:
        return answer.lower() if answer.lower() in words else None

    return _ask(operator, f"{question} ({choice})", parse, f"one of these: {choice}")


def require_yes(operator: OperatorTerminal, question: str) -> None:
    """Raise `Stopped` unless the operator answers yes."""
    if ask_choice(operator, question, ("yes", "no")) == "no":
        raise Stopped(f"the answer was no to: {question}")


def ask_length(operator: OperatorTerminal, question: str) -> float | None:
    """Return a length in mm; None if the operator cannot measure it.

    Raises
    ------
    Stopped
        After `MAX_ATTEMPTS` invalid answers.
    """

    def parse(answer: str) -> tuple[float | None] | None:
        if answer.lower() == UNKNOWN:
            return (None,)
        try:
            mm = float(answer)
        except ValueError:
            return None
        return (mm,) if 0.0 <= mm <= MAX_LENGTH_MM else None

    expected = f"a number of mm from 0 to {MAX_LENGTH_MM:g}, or {UNKNOWN}"
    return _ask(operator, f"{question} (or: {UNKNOWN})", parse, expected)[0]


def _ask(
    operator: OperatorTerminal, question: str, parse: Callable[[str], Answer | None], expected: str
) -> Answer:
    for _ in range(MAX_ATTEMPTS):
        answer = parse(operator.ask(question))
        if answer is not None:
            return answer
        operator.notify(f"Please answer with {expected}.")
    raise Stopped(f"no valid answer to: {question}")
