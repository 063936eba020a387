"""Questions to the operator at the arm, repeated until an answer is valid."""

from collections.abc import Callable, Sequence

from rcmservo.errors import Stopped
from rcmservo.live.device_protocols import OperatorTerminal

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
    return _ask(operator, f"{question} ({choice})", words.__contains__, f"one of these: {choice}")


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
    expected = f"a number of mm from 0 to {MAX_LENGTH_MM:g}, or {UNKNOWN}"
    answer = _ask(operator, f"{question} (or: {UNKNOWN})", _is_length_or_unknown, expected)
    return None if answer == UNKNOWN else float(answer)


def _is_length_or_unknown(answer: str) -> bool:
    try:
        return answer == UNKNOWN or 0.0 <= float(answer) <= MAX_LENGTH_MM
    except ValueError:
        return False


def _ask(
    operator: OperatorTerminal, question: str, is_valid: Callable[[str], bool], expected: str
) -> str:
    """Return the first valid answer, in lower case."""
    for _ in range(MAX_ATTEMPTS):
        answer = operator.ask(question).lower()
        if is_valid(answer):
            return answer
        operator.notify(f"Please answer with {expected}.")
    raise Stopped(f"no valid answer to: {question}")
