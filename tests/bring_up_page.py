"""Answers of docs/bring_up.md to the questions of its tutorial, with the emulator's output."""

import re

from conftest import ROOT

PAGE = (ROOT / "docs/bring_up.md").read_text()
ROWS = re.findall(r"^\| (.+?) \| (.+?) \|$", PAGE.partition("| question with | answer |")[2], re.M)
"""Rows of the table: words of a question, and the answer to type."""


def answer_to(question: str, printed: str) -> str:
    """Return the page's answer to a question; `printed` is the line that the emulator printed."""
    answers = [answer for words, answer in ROWS if words in question]
    assert answers, f"the page has no answer to: {question}"
    return _typed(answers[0], printed)


def _typed(answer: str, printed: str) -> str:
    """Return the characters that a reader of the page types."""
    if answer == "Enter":
        return ""
    if answer.startswith("`"):
        return answer.strip("`")
    words = re.search(r'(before|after) "(.+)"', answer)
    assert words is not None, answer
    before, _, after = printed.partition(words[2])
    assert after, f"the emulator has not printed {words[2]}"
    numbers = re.findall(r"-?[\d.]+", before if words[1] == "before" else after)
    if "three numbers" in answer:
        return " ".join(numbers[:3])
    return numbers[-1] if words[1] == "before" else numbers[0]
