"""`rig check` of a rate-controlled arm: it must stop by itself when its commands cease."""

from dataclasses import replace

import numpy as np
from rig_check_lab import FaultyLab, Mistake, MiswiredArm

from rcmservo.interfaces import ArmMeasurement, Command, Floats

FIRST_QUESTIONS = 4
"""Questions within which the check interrupts the commands of a rate-controlled arm."""


class RateControlledArm(MiswiredArm):
    """Arm that stops when its commands cease, or continues with its last command."""

    is_rate_controlled, continues, silent, freezes = True, False, False, False
    last: Command
    last_measured: ArmMeasurement

    def suspend_communication(self) -> None:
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

    def measure(self) -> ArmMeasurement:
        if self.silent and self.freezes:
            return self.last_measured
        self.last_measured = measured = super().measure()
        if self.silent and self.continues:
            number, now = self.last.number + 1, measured.time
            self.last = replace(self.last, number=number, time=now, deadline=now + 50_000_000)
            super().apply(self.last)
        return measured


def make_rate_controlled_lab() -> FaultyLab:
    lab = FaultyLab(Mistake(), seed=1)
    lab.arm.__class__ = RateControlledArm
    return lab


def refuse_later_questions(lab: FaultyLab) -> None:
    """Let the operator end the check after the questions within which it interrupts commands."""
    lab.operator.override = lambda _: (
        "no" if len(lab.operator.questions) > FIRST_QUESTIONS else None
    )


def test_an_arm_that_stops_passes_and_is_tested_in_one_of_its_first_small_motions() -> None:
    lab = make_rate_controlled_lab()
    refuse_later_questions(lab)
    report = lab.check()
    assert [finding.where for finding in report.findings] == ["operator"]
    assert len(lab.operator.questions) > FIRST_QUESTIONS
    (test,) = [
        k
        for k, question in enumerate(lab.operator.questions)
        if "interrupt the commands" in question
    ]
    motions = [
        question.split(",")[0]
        for question in lab.operator.questions
        if question.startswith("Move joint")
    ]
    assert motions[test - 1].removesuffix(" in either direction") in " ".join(motions[: test - 1])


def test_an_arm_that_stops_answering_does_not_count_as_at_rest() -> None:
    lab = make_rate_controlled_lab()
    assert isinstance(lab.arm, RateControlledArm)
    lab.arm.freezes = lab.arm.continues = True
    report = lab.check()
    assert [finding.what for finding in report.findings] == ["the arm does not answer"]
    assert not lab.rig.arm.measure().enabled


def test_an_arm_that_keeps_moving_is_reported_and_stopped_at_once() -> None:
    lab = make_rate_controlled_lab()
    assert isinstance(lab.arm, RateControlledArm)
    lab.arm.continues = True
    report = lab.check()
    assert [finding.line for finding in report.findings] == ["jv = false"]
    assert not report.ok and not lab.arm.measure().enabled
    assert lab.arm.max_travel < 0.5
    assert "interrupt the commands" in lab.operator.questions[-1]


def test_a_position_controlled_arm_is_not_tested() -> None:
    lab = make_rate_controlled_lab()
    assert isinstance(lab.arm, RateControlledArm)
    lab.arm.is_rate_controlled = False
    refuse_later_questions(lab)
    lab.check()
    assert len(lab.operator.questions) > FIRST_QUESTIONS
    assert not any("interrupt the commands" in question for question in lab.operator.questions)


def test_the_operator_may_refuse_the_test() -> None:
    lab = make_rate_controlled_lab()
    lab.operator.override = lambda question: "no" if "interrupt the commands" in question else None
    report = lab.check()
    assert [finding.where for finding in report.findings] == ["operator"]
    assert isinstance(lab.arm, RateControlledArm)
    assert not lab.arm.silent
