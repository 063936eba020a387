"""Events that end the control of a CRTK arm and switch it off, on a simulated clock."""

from dataclasses import replace
from typing import Any

import pytest
from simulated_transport import MS, PATIENCE, RATES, moving_arm, setpoints

from rcmservo.hardware.crtk import messages
from rcmservo.interfaces import Command
from rcmservo.live.device_protocols import NotReady


def test_after_the_deadline_nothing_is_sent_and_the_arm_is_switched_off() -> None:
    lab, arm = moving_arm()
    count = len(setpoints(lab))
    lab.advance(PATIENCE + 10 * MS)
    assert not arm.measure().enabled and lab.device.state == "DISABLED"
    assert "no command came in time" in arm.off_reason
    assert lab.tick(arm, RATES).tolist() == [0.0, 0.0, 0.0] and len(setpoints(lab)) == count


def test_disable_is_repeated_until_the_arm_reports_that_it_is_off() -> None:
    lab, arm = moving_arm()
    lost = 3

    def lose(topic: str, message: Any) -> bool:
        nonlocal lost
        lost -= topic.endswith("state_command")
        return topic.endswith("state_command") and lost >= 0

    lab.network.lose = lose
    arm.apply(Command(lab.number + 1, lab.now, lab.now + PATIENCE, RATES, False))
    assert arm.measure().enabled
    lab.advance(500 * MS)
    assert not arm.measure().enabled and arm.off_reason == ""


def test_an_arm_that_stays_on_is_reported_and_disable_is_repeated() -> None:
    lab, arm = moving_arm()
    lab.network.lose = lambda topic, message: topic.endswith("state_command")
    arm.apply(Command(lab.number + 1, lab.now, lab.now + PATIENCE, RATES, False))
    lab.advance(3000 * MS)
    assert arm.measure().enabled
    assert arm.off_reason == "PSM1 does not report that it is off: use its emergency stop"
    lab.network.lose = lambda topic, message: False
    lab.advance(500 * MS)
    assert not arm.measure().enabled and arm.off_reason == ""


def test_disable_is_not_repeated_after_the_arm_reported_that_it_is_off() -> None:
    lab, arm = moving_arm()
    arm.apply(Command(lab.number + 1, lab.now, lab.now + PATIENCE, RATES, False))
    lab.advance(500 * MS)
    lab.device.receive_command(messages.StringStamped(lab.real(), "enable"), "console")
    lab.advance(500 * MS)
    assert lab.device.state == "ENABLED"


def test_closing_an_arm_that_stays_on_is_reported() -> None:
    lab, arm = moving_arm()
    lab.network.lose = lambda topic, message: topic.endswith("state_command")
    arm.close()
    assert arm.off_reason == "PSM1 does not report that it is off: use its emergency stop"


def test_an_arm_that_is_no_longer_homed_is_switched_off() -> None:
    lab, arm = moving_arm()
    lab.network.lose = lambda topic, message: topic.endswith("state_command")
    lab.device.receive_command(messages.StringStamped(lab.real(), "unhome"), "console")
    assert lab.device.state == "ENABLED" and not arm.measure().enabled
    assert arm.off_reason == "PSM1 is no longer homed, and it was switched off"
    lab.network.lose = lambda topic, message: False
    lab.advance(200 * MS)
    assert lab.device.state == "DISABLED"


def test_of_two_reports_with_one_stamp_the_unhomed_one_counts() -> None:
    lab, arm = moving_arm()
    state = [message for topic, message in lab.network.sent if topic == "PSM1/operating_state"][-1]
    endpoint = lab.network.endpoint("device")
    endpoint.publish(messages.OPERATING_STATE.under("PSM1"), replace(state, is_homed=False))
    lab.advance(10 * MS)
    assert not arm.measure().enabled and lab.device.state == "DISABLED"


@pytest.mark.parametrize("age", [-1, 100 * MS, 3600_000 * MS, None])
def test_a_second_arm_of_the_same_name_ends_the_control(age: int | None) -> None:
    """Reports of any age count, and reports without a stamp."""
    lab, arm = moving_arm()
    other = lab.network.endpoint("other")
    stamp = 0 if age is None else lab.real() - age
    other.publish(messages.MEASURED_JS.under("PSM1"), messages.JointState(stamp, (), (0.0,) * 6))
    lab.advance(10 * MS)
    assert "two arms publish as PSM1" in arm.off_reason and lab.device.state == "DISABLED"
    with pytest.raises(NotReady, match="two arms"):
        arm.enable()


@pytest.mark.parametrize("stamp", [0, 1])
def test_an_operating_state_of_a_second_arm_ends_the_control(stamp: int) -> None:
    lab, arm = moving_arm()
    other = lab.network.endpoint("other")
    other.publish(
        messages.OPERATING_STATE.under("PSM1"), messages.OperatingState(stamp, "DISABLED")
    )
    lab.advance(10 * MS)
    assert "two arms publish as PSM1" in arm.off_reason and lab.device.state == "DISABLED"


@pytest.mark.parametrize("topic", ["servo_jp", "servo_jv", "move_jp", "servo_cp", "move_cp"])
def test_a_second_client_is_detected_and_the_arm_is_switched_off(topic: str) -> None:
    lab, arm = moving_arm()
    other = lab.network.endpoint("other")
    kind = messages.PoseStamped if topic.endswith("cp") else messages.JointState
    other.publish(messages.Topic(f"PSM1/{topic}", kind), kind(lab.real()))
    lab.advance(10 * MS)
    assert "another client sends motion commands to PSM1" in arm.off_reason
    assert lab.device.state == "DISABLED"
    with pytest.raises(NotReady, match="another client moves PSM1"):
        arm.enable()
    lab.advance(600 * MS)
    arm.enable()


def test_closing_switches_the_arm_off() -> None:
    lab, arm = moving_arm()
    arm.close()
    assert lab.device.state == "DISABLED"


def test_of_two_reports_with_one_stamp_the_off_state_counts() -> None:
    lab, arm = moving_arm()
    endpoint = lab.network.endpoint("device")
    state = [message for topic, message in lab.network.sent if topic == "PSM1/operating_state"][-1]
    assert state.state == "ENABLED"
    endpoint.publish(messages.OPERATING_STATE.under("PSM1"), replace(state, state="FAULT"))
    assert not arm.measure().enabled and "changed to FAULT by itself" in arm.off_reason
    endpoint.publish(messages.OPERATING_STATE.under("PSM1"), state)
    assert not arm.measure().enabled
