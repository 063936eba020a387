"""What ends it that a client has a CRTK arm, and that the arm is switched off then, on an injected
clock."""

from dataclasses import replace
from typing import Any

import pytest
from simulated_wire import MS, PATIENCE, RATES, driven, sent

from rcmservo.hardware.crtk import messages as m
from rcmservo.interfaces import Command
from rcmservo.live.lab import NotReady


def test_past_the_deadline_nothing_is_sent_and_it_is_switched_off() -> None:
    lab, arm = driven()
    count = len(sent(lab))
    lab.let_pass(PATIENCE + 10 * MS)
    assert not arm.measure().enabled and lab.device.state == "DISABLED"
    assert "no command came in time" in arm.why_off
    assert lab.tick(arm, RATES).tolist() == [0.0, 0.0, 0.0] and len(sent(lab)) == count


def test_off_is_what_the_arm_says_and_it_is_told_until_it_does() -> None:
    lab, arm = driven()
    lost = 3

    def lose(topic: str, said: Any) -> bool:
        nonlocal lost
        lost -= topic.endswith("state_command")
        return topic.endswith("state_command") and lost >= 0

    lab.wire.lose = lose
    arm.apply(Command(lab.number + 1, lab.now, lab.now + PATIENCE, RATES, False))
    assert arm.measure().enabled
    lab.let_pass(500 * MS)
    assert not arm.measure().enabled and arm.why_off == ""


def test_off_is_said_for_as_long_as_the_arm_says_that_it_is_on() -> None:
    lab, arm = driven()
    lab.wire.lose = lambda topic, said: topic.endswith("state_command")
    arm.apply(Command(lab.number + 1, lab.now, lab.now + PATIENCE, RATES, False))
    lab.let_pass(3000 * MS)
    assert arm.measure().enabled
    assert arm.why_off == "PSM1 does not say that it is off: use its emergency stop"
    lab.wire.lose = lambda topic, said: False
    lab.let_pass(500 * MS)
    assert not arm.measure().enabled and arm.why_off == ""


def test_once_it_said_that_it_is_off_it_is_somebody_else_s() -> None:
    lab, arm = driven()
    arm.apply(Command(lab.number + 1, lab.now, lab.now + PATIENCE, RATES, False))
    lab.let_pass(500 * MS)
    lab.device.hear_command(m.StringStamped(lab.real(), "enable"), "console")
    lab.let_pass(500 * MS)
    assert lab.device.state == "ENABLED"


def test_hanging_up_an_arm_that_does_not_go_off_says_so() -> None:
    lab, arm = driven()
    lab.wire.lose = lambda topic, said: topic.endswith("state_command")
    arm.close()
    assert arm.why_off == "PSM1 does not say that it is off: use its emergency stop"


def test_an_arm_that_is_no_longer_homed_is_switched_off() -> None:
    lab, arm = driven()
    lab.wire.lose = lambda topic, said: topic.endswith("state_command")
    lab.device.hear_command(m.StringStamped(lab.real(), "unhome"), "console")
    assert lab.device.state == "ENABLED" and not arm.measure().enabled
    assert arm.why_off == "PSM1 is no longer homed, and it was switched off"
    lab.wire.lose = lambda topic, said: False
    lab.let_pass(200 * MS)
    assert lab.device.state == "DISABLED"


def test_of_two_words_with_one_stamp_that_it_is_not_homed_counts() -> None:
    lab, arm = driven()
    state = [said for topic, said in lab.wire.said if topic == "PSM1/operating_state"][-1]
    end = lab.wire.end("device")
    end.publish(m.OPERATING_STATE.under("PSM1"), replace(state, is_homed=False))
    lab.let_pass(10 * MS)
    assert not arm.measure().enabled and lab.device.state == "DISABLED"


@pytest.mark.parametrize("age", [-1, 100 * MS, 3600_000 * MS, None])
def test_a_second_arm_of_the_same_name_ends_it(age: int | None) -> None:
    """However old its words are, or without a stamp."""
    lab, arm = driven()
    other = lab.wire.end("other")
    stamp = 0 if age is None else lab.real() - age
    other.publish(m.MEASURED_JS.under("PSM1"), m.JointState(stamp, (), (0.0,) * 6))
    lab.let_pass(10 * MS)
    assert "two arms speak as PSM1" in arm.why_off and lab.device.state == "DISABLED"
    with pytest.raises(NotReady, match="two arms"):
        arm.enable()


@pytest.mark.parametrize("stamp", [0, 1])
def test_a_second_arm_that_tells_how_it_is_ends_it(stamp: int) -> None:
    lab, arm = driven()
    other = lab.wire.end("other")
    other.publish(m.OPERATING_STATE.under("PSM1"), m.OperatingState(stamp, "DISABLED"))
    lab.let_pass(10 * MS)
    assert "two arms speak as PSM1" in arm.why_off and lab.device.state == "DISABLED"


@pytest.mark.parametrize("topic", ["servo_jp", "servo_jv", "move_jp", "servo_cp", "move_cp"])
def test_a_second_client_is_seen_and_both_stop(topic: str) -> None:
    lab, arm = driven()
    other = lab.wire.end("other")
    kind = m.PoseStamped if topic.endswith("cp") else m.JointState
    other.publish(m.Topic(f"PSM1/{topic}", kind), kind(lab.real()))
    lab.let_pass(10 * MS)
    assert "somebody else sends PSM1 where to go" in arm.why_off
    assert lab.device.state == "DISABLED"
    with pytest.raises(NotReady, match="somebody else moves PSM1"):
        arm.enable()
    lab.let_pass(600 * MS)
    arm.enable()


def test_closing_switches_it_off() -> None:
    lab, arm = driven()
    arm.close()
    assert lab.device.state == "DISABLED"


def test_of_two_words_with_one_stamp_that_it_is_off_counts() -> None:
    lab, arm = driven()
    end = lab.wire.end("device")
    state = [said for topic, said in lab.wire.said if topic == "PSM1/operating_state"][-1]
    assert state.state == "ENABLED"
    end.publish(m.OPERATING_STATE.under("PSM1"), replace(state, state="FAULT"))
    assert not arm.measure().enabled and "went FAULT by itself" in arm.why_off
    end.publish(m.OPERATING_STATE.under("PSM1"), state)
    assert not arm.measure().enabled
