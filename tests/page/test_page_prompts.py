"""Questions at the page: only an answer to the displayed question counts, after a time to read it.

Joints must be within the limits and confirmed.
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
from rcmservo.page.messages import Enable, Note, Reply, Standby
from rcmservo.page.prompts import MIN_READING_TIME_NS, PagePrompts


class Page:
    """Simulated operator who answers each question after some polls, with a plant and its clock."""

    def __init__(self, *answers: tuple[int, Any]) -> None:
        self.channels, self.answers, self.polls, self.now = (
            PageChannels(get_context("spawn")),
            list(answers),
            0,
            0,
        )
        self.prompts: list[Standby] = []
        self.notes: list[str] = []
        self.defined: Any = None
        clock: Any = SimpleNamespace(now=lambda: self.now, wait_until=self._wait)
        self.plant: Any = SimpleNamespace(clock=clock, stop_requested=self._poll, arm=self)

    def _wait(self, time: int) -> None:
        self.now = max(self.now, time)

    def _poll(self) -> bool:
        for one in self.channels.status.receive_all():
            if isinstance(one, Standby):
                self.prompts.append(one)
                self.polls = 0
            if isinstance(one, Note):
                self.notes.append(one.words)
        self.polls += 1
        if self.answers and self.polls == self.answers[0][0]:
            answer = self.answers.pop(0)[1]
            if isinstance(answer, str):
                answer = Reply(self.prompts[-1].question, answer)
            assert self.channels.requests.send(answer)
        return self.polls > 500

    def set_position(self, q: Any) -> None:
        self.defined = q

    def measure(self) -> ArmMeasurement:
        return ArmMeasurement(0, self.defined, False)


READ_AFTER_POLLS = MIN_READING_TIME_NS // 20_000_000 + 2
"""Number of polls after which an answer counts."""


def test_typed_joints_are_within_limits_and_confirmed_before_the_arm_gets_them() -> None:
    start = make_laboratory().rig.scene.start
    typed = " ".join(f"{value:.4f}" for value in start)
    page = Page(
        (READ_AFTER_POLLS, "here"),
        (READ_AFTER_POLLS, "9 0 100"),
        (READ_AFTER_POLLS, typed),
        (READ_AFTER_POLLS, "no"),
        (READ_AFTER_POLLS, typed),
        (READ_AFTER_POLLS, ""),
    )
    define_joints(PagePrompts(page.channels, page.plant), page.plant, RigDescription())
    assert np.allclose(page.defined, start, atol=1e-4)
    words = [one.words for one in page.prompts]
    assert "Move the arm by hand to a mark" in words[0]
    assert "three numbers (rad, rad, mm)" in words[1] and "within theta" in words[2]
    assert [one.question[:5] for one in page.prompts] == ["Joint"] * 3 + [
        "The a",
        "Joint",
        "The a",
    ]


@pytest.mark.parametrize(
    "answer",
    [
        (1, "0 0 100"),
        (READ_AFTER_POLLS, Reply("Another?", "0 0 100")),
        (READ_AFTER_POLLS, Enable()),
    ],
)
def test_a_premature_answer_or_one_to_another_question_is_ignored(answer: Any) -> None:
    page = Page(answer)
    with pytest.raises(Stopped):
        PagePrompts(page.channels, page.plant).ask("Joints?")
    assert page.notes == (
        ["the drive is off: answer the question first"] if answer[1] == Enable() else []
    )
