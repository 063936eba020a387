"""An arm that is sent speeds is seen to stop by itself before a servo may rely on that."""

from dataclasses import replace

import numpy as np
import pytest
from rig_check_lab import Mistake, MiswiredArm, WrongLab

from rcmservo.bringup.check import CheckReport
from rcmservo.interfaces import Command, Floats, Measured

FIRST_QUESTIONS = 8
"""Questions within which an arm that is sent speeds is left alone."""


class SpeedArm(MiswiredArm):
    """One that stops by itself once nothing is sent, or goes on by its last word."""

    by_speeds, goes_on, silent, freezes = True, False, False, False
    last: Command
    told: Measured

    def fall_silent(self) -> None:
        self.silent = True

    def enable(self) -> None:
        self.silent = False
        super().enable()

    def apply(self, command: Command) -> Floats:
        if not command.enabled:
            self.silent = False
        if self.silent:
            return np.zeros(3)
        self.last = command
        return super().apply(command)

    def measure(self) -> Measured:
        if self.silent and self.freezes:
            return self.told
        self.told = told = super().measure()
        if self.silent and self.goes_on:
            number, now = self.last.number + 1, told.time
            self.last = replace(self.last, number=number, time=now, deadline=now + 50_000_000)
            super().apply(self.last)
        return told


def checked(goes_on: bool) -> tuple[WrongLab, CheckReport]:
    lab = WrongLab(Mistake(), seed=1)
    lab.arm.__class__ = SpeedArm
    assert isinstance(lab.arm, SpeedArm)
    lab.arm.goes_on = goes_on
    return lab, lab.check()


@pytest.mark.slow
def test_one_that_stops_passes_and_is_left_alone_on_one_of_its_first_small_ways() -> None:
    lab, report = checked(goes_on=False)
    assert report.ok
    (alone,) = [k for k, asked in enumerate(lab.person.asked) if "be left alone" in asked]
    assert alone < FIRST_QUESTIONS
    ways = [asked.split(",")[0] for asked in lab.person.asked if asked.startswith("Move joint")]
    assert ways[alone - 1].removesuffix(" either way") in " ".join(ways[: alone - 1])


def test_what_is_told_no_more_is_not_at_rest() -> None:
    lab = WrongLab(Mistake(), seed=1)
    lab.arm.__class__ = SpeedArm
    assert isinstance(lab.arm, SpeedArm)
    lab.arm.freezes = lab.arm.goes_on = True
    report = lab.check()
    assert [finding.what for finding in report.findings] == ["the arm does not answer"]
    assert not lab.rig.arm.measure().enabled


def test_one_that_goes_on_is_told_and_stopped_at_once() -> None:
    lab, report = checked(goes_on=True)
    assert [finding.line for finding in report.findings] == ["jv = false"]
    assert not report.ok and not lab.arm.measure().enabled
    assert lab.arm.farthest < 0.5
    assert "be left alone" in lab.person.asked[-1]


def test_one_that_is_sent_positions_is_not_asked_to() -> None:
    lab = WrongLab(Mistake(), seed=1)
    lab.arm.__class__ = SpeedArm
    lab.arm.by_speeds = False
    lab.person.instead = lambda _: "no" if len(lab.person.asked) > FIRST_QUESTIONS else None
    lab.check()
    assert len(lab.person.asked) > FIRST_QUESTIONS
    assert not any("be left alone" in question for question in lab.person.asked)


def test_a_person_may_refuse_it() -> None:
    lab = WrongLab(Mistake(), seed=1)
    lab.arm.__class__ = SpeedArm
    lab.person.instead = lambda question: "no" if "be left alone" in question else None
    report = lab.check()
    assert [finding.where for finding in report.findings] == ["person"]
    assert not lab.arm.silent


@pytest.mark.slow
@pytest.mark.parametrize("signs", [(-1.0, 1.0, 1.0), (1.0, 1.0, 1.0)])
def test_an_arm_that_counts_itself_is_checked_by_its_signs(
    signs: tuple[float, float, float],
) -> None:
    lab = WrongLab(Mistake(factors=signs), seed=1, signs_only=True)
    report = lab.check()
    assert lab.arm.farthest < 2.0
    wrong = [finding for finding in report.findings if finding.where.startswith("arm")]
    assert report.done and (not wrong) == (signs[0] > 0.0)
    if wrong:
        assert (wrong[0].where, wrong[0].line) == ("arm.signs[0]", "signs = [1.0, 1.0, 1.0]")
