"""The answers that docs/bring_up.md gives to the questions of its tutorial, with what the emulator
prints.
"""

import re

from conftest import ROOT

PAGE = (ROOT / "docs/bring_up.md").read_text()
ROWS = re.findall(r"^\| (.+?) \| (.+?) \|$", PAGE.partition("| question with | answer |")[2], re.M)
"""Words of a question, and what to type, in the order of the table."""


def answer_to(question: str, printed: str) -> str:
    """The answer that the page gives to a question, with the line that the emulator printed."""
    answers = [answer for words, answer in ROWS if words in question]
    assert answers, f"the page has no answer to: {question}"
    return _typed(answers[0], printed)


def _typed(answer: str, printed: str) -> str:
    """What a reader of the page types."""
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
