"""A person is asked at the page where the arm stands: what answers this question, and was read,
counts, within the limits, and agreed to.
"""

from multiprocessing import get_context
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from conftest import make_laboratory
from rcmservo.cli.lab.hardware_prompts import define_joints
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import Stopped
from rcmservo.interfaces import ArmMeasurement
from rcmservo.page.channels import PageChannels
from rcmservo.page.messages import Between, Enable, Note, Reply
from rcmservo.page.prompts import READ, PagePrompts


class Page:
    """A person who sees what is said and answers it after so many looks, and the servo's plant, in
    no time at all.
    """

    def __init__(self, *says: tuple[int, Any]) -> None:
        self.desk, self.says, self.looks, self.now = (
            PageChannels(get_context("spawn")),
            list(says),
            0,
            0,
        )
        self.asked: list[Between] = []
        self.notes: list[str] = []
        self.defined: Any = None
        clock: Any = SimpleNamespace(now=lambda: self.now, wait_until=self._wait)
        self.plant: Any = SimpleNamespace(clock=clock, told_to_end=self._look, arm=self)

    def _wait(self, time: int) -> None:
        self.now = max(self.now, time)

    def _look(self) -> bool:
        for one in self.desk.status.receive_all():
            if isinstance(one, Between):
                self.asked.append(one)
                self.looks = 0
            if isinstance(one, Note):
                self.notes.append(one.words)
        self.looks += 1
        if self.says and self.looks == self.says[0][0]:
            told = self.says.pop(0)[1]
            if isinstance(told, str):
                told = Reply(self.asked[-1].asks, told)
            assert self.desk.requests.send(told)
        return self.looks > 500

    def define(self, q: Any) -> None:
        self.defined = q

    def measure(self) -> ArmMeasurement:
        return ArmMeasurement(0, self.defined, False)


READ_BY = READ // 20_000_000 + 2
"""Looks after which a question was read."""


def test_joints_are_typed_within_limits_and_agreed_to_before_the_arm_is_told() -> None:
    start = make_laboratory().rig.scene.start
    typed = " ".join(f"{value:.4f}" for value in start)
    page = Page(
        (READ_BY, "here"),
        (READ_BY, "9 0 100"),
        (READ_BY, typed),
        (READ_BY, "no"),
        (READ_BY, typed),
        (READ_BY, ""),
    )
    define_joints(PagePrompts(page.desk, page.plant), page.plant, RigDescription())
    assert np.allclose(page.defined, start, atol=1e-4)
    words = [one.words for one in page.asked]
    assert "Move the arm by hand to a mark" in words[0]
    assert "three numbers (rad, rad, mm)" in words[1] and "within theta" in words[2]
    assert [one.asks[:10] for one in page.asked] == ["Joint valu"] * 3 + [
        "The arm is",
        "Joint valu",
        "The arm is",
    ]


@pytest.mark.parametrize(
    "told", [(1, "0 0 100"), (READ_BY, Reply("Another?", "0 0 100")), (READ_BY, Enable())]
)
def test_what_was_said_too_soon_or_to_another_question_is_no_answer(told: Any) -> None:
    page = Page(told)
    with pytest.raises(Stopped):
        PagePrompts(page.desk, page.plant).ask("Where?")
    assert page.notes == (["the drive is off: answer first"] if told[1] == Enable() else [])
