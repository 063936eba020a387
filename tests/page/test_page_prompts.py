"""A person is asked at the page where the arm stands: what answers this question, and was read,
counts, within the limits, and agreed to.
"""

from multiprocessing import get_context
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from conftest import laboratory
from rcmservo.cli.lab.hardware_prompts import define
from rcmservo.config.rig_file import Lab
from rcmservo.errors import Stopped
from rcmservo.interfaces import Measured
from rcmservo.page.channels import Desk
from rcmservo.page.messages import Enable, Note, Reply, Standby
from rcmservo.page.prompts import MIN_READING_TIME_NS, PagePerson


class Page:
    """A person who sees what is said and answers it after so many looks, and the servo's plant, in
    no time at all.
    """

    def __init__(self, *says: tuple[int, Any]) -> None:
        self.desk, self.answers, self.polls, self.now = Desk(get_context("spawn")), list(says), 0, 0
        self.prompts: list[Standby] = []
        self.notes: list[str] = []
        self.defined: Any = None
        clock: Any = SimpleNamespace(now=lambda: self.now, wait_until=self._wait)
        self.plant: Any = SimpleNamespace(clock=clock, told_to_end=self._poll, arm=self)

    def _wait(self, time: int) -> None:
        self.now = max(self.now, time)

    def _poll(self) -> bool:
        for one in self.desk.said.heard():
            if isinstance(one, Standby):
                self.prompts.append(one)
                self.polls = 0
            if isinstance(one, Note):
                self.notes.append(one.words)
        self.polls += 1
        if self.answers and self.polls == self.answers[0][0]:
            told = self.answers.pop(0)[1]
            if isinstance(told, str):
                told = Reply(self.prompts[-1].question, told)
            assert self.desk.wants.put(told)
        return self.polls > 500

    def define(self, q: Any) -> None:
        self.defined = q

    def measure(self) -> Measured:
        return Measured(0, self.defined, False)


READ_AFTER_POLLS = MIN_READING_TIME_NS // 20_000_000 + 2
"""Looks after which a question was read."""


def test_typed_joints_are_within_limits_and_confirmed_before_the_arm_gets_them() -> None:
    start = laboratory().rig.scene.start
    typed = " ".join(f"{value:.4f}" for value in start)
    page = Page(
        (READ_AFTER_POLLS, "here"),
        (READ_AFTER_POLLS, "9 0 100"),
        (READ_AFTER_POLLS, typed),
        (READ_AFTER_POLLS, "no"),
        (READ_AFTER_POLLS, typed),
        (READ_AFTER_POLLS, ""),
    )
    define(PagePerson(page.desk, page.plant), page.plant, Lab())
    assert np.allclose(page.defined, start, atol=1e-4)
    words = [one.words for one in page.prompts]
    assert "Bring the arm by hand to a mark" in words[0]
    assert "three numbers (rad, rad, mm)" in words[1] and "within theta" in words[2]
    assert [one.question[:10] for one in page.prompts] == ["The joints"] * 3 + [
        "The arm st",
        "The joints",
        "The arm st",
    ]


@pytest.mark.parametrize(
    "told",
    [
        (1, "0 0 100"),
        (READ_AFTER_POLLS, Reply("Another?", "0 0 100")),
        (READ_AFTER_POLLS, Enable()),
    ],
)
def test_a_premature_answer_or_one_to_another_question_is_ignored(told: Any) -> None:
    page = Page(told)
    with pytest.raises(Stopped):
        PagePerson(page.desk, page.plant).ask("Where?")
    assert page.notes == (["the drive is off: answer first"] if told[1] == Enable() else [])
