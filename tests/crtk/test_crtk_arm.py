"""Driver of a CRTK arm on a simulated clock: sent commands and accepted reports."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated_transport import (
    EPOCH,
    LIMITS,
    MS,
    PATIENCE,
    RATES,
    START,
    TICK,
    CrtkLab,
    moving_arm,
    setpoints,
)

from rcmservo.errors import BadInput
from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.bounded_lead import MAX_DRAG, MAX_STEP_NS, BoundedLead
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.interfaces import Command
from rcmservo.live.device_protocols import NotReady

rates = st.tuples(*(st.floats(-2.0, 2.0) for _ in range(3)))


def test_joints_are_measured_in_rad_and_mm_and_the_arm_is_off() -> None:
    measured = CrtkLab().client().measure()
    assert measured.q == pytest.approx(START) and not measured.enabled


def test_rates_become_positions_in_rad_and_m_and_the_wrist_stays() -> None:
    lab, arm = moving_arm()
    moved = arm.measure().q - START
    assert moved == pytest.approx(RATES * 0.5, rel=0.2)
    last = setpoints(lab)[-1]
    assert last.position[:3] == pytest.approx((START + RATES * 0.5) * [1.0, 1.0, 1e-3], rel=1e-2)
    assert last.position[3:] == (0.0, 0.0, 0.0) and len(last.name) == 6
    assert arm.command_counts().sent == 50 and arm.command_counts().warned == 0


def test_signs_reverse_joints_and_commands() -> None:
    lab = CrtkLab(signs=(-1.0, 1.0, 1.0))
    arm = lab.client()
    assert arm.measure().q[0] == pytest.approx(-START[0])
    arm.enable()
    for _ in range(20):
        lab.tick(arm, RATES)
    assert arm.measure().q[0] > -START[0] + 0.01 and lab.joints.q[0] < START[0] - 0.01


@given(
    st.lists(st.tuples(rates, st.integers(0, 400) | st.just(10), rates), max_size=40),
    st.tuples(*(st.floats(0.01, 0.5) for _ in range(3))),
    st.sampled_from([0.01, 1.0, 100.0]),
)
def test_the_setpoint_never_leads_by_more_than_the_lead(
    steps: list[tuple[Any, int, Any]], lead: Any, disturbance: float
) -> None:
    """Try any measurements and pauses of the loop.

    The returned rates are those of the setpoint, which never jumps.
    """
    setpoint = BoundedLead(np.array(lead), LIMITS)
    now, last, measured = 0, 0, START.copy()
    before = START.copy()
    setpoint.start(START, now)
    for rates_now, pause, push in steps:
        now += pause * MS
        measured = measured + np.array(push) * disturbance
        step = setpoint.step(np.array(rates_now), measured, now)
        if step is None:
            assert disturbance > 0.01
            continue
        q, real_rates = step
        elapsed, last = now - last, now
        commanded = np.abs(rates_now) * min(elapsed, MAX_STEP_NS) * 1e-9
        assert (np.abs(q - before) <= commanded + MAX_DRAG + 1e-9).all()
        assert (np.abs(q - measured) <= np.array(lead) + 1e-9).all()
        if elapsed:
            assert real_rates * elapsed * 1e-9 == pytest.approx(q - before, abs=1e-9)
        before = q


def test_the_setpoint_stays_within_the_joint_limits() -> None:
    lead = BoundedLead(np.full(3, 10.0), LIMITS)
    lead.start(np.array(LIMITS.upper), 0)
    step = lead.step(np.full(3, 1.0), np.array(LIMITS.upper), TICK)
    assert step is not None and (step[0] < LIMITS.upper).all()


@pytest.mark.parametrize("offset", [-1.0, 1.0])
def test_an_implausible_position_moves_nothing_and_switches_the_arm_off(offset: float) -> None:
    """The report is recent and finite, and one joint is far from its setpoint."""
    lab, arm = moving_arm()
    count, last = len(setpoints(lab)), setpoints(lab)[-1]
    position = (last.position[0] + offset, *last.position[1:])
    lab.network.endpoint("device").publish(
        messages.MEASURED_JS.under("PSM1"), messages.JointState(lab.real() + MS, (), position)
    )
    assert not lab.tick(arm, RATES).any()
    assert len(setpoints(lab)) == count and lab.device.state == "DISABLED"
    assert "reported a position far from its setpoint" in arm.off_reason
    assert arm.command_counts().withheld == 1


def test_a_late_tick_returns_the_real_rates() -> None:
    lab, arm = moving_arm()
    lab.advance(30 * MS)
    applied = lab.tick(arm, RATES)
    assert applied == pytest.approx(RATES * 20.0 / 40.0, rel=1e-6)


def test_the_setpoint_of_a_blocked_arm_stays_within_the_lead() -> None:
    lab, arm = moving_arm()
    lab.joints.step = lambda rates, on, time: lab.joints.q  # type: ignore[method-assign]
    here = lab.joints.q * [1.0, 1.0, 1e-3]
    for _ in range(100):
        applied = lab.tick(arm, RATES)
    ahead = np.array(setpoints(lab)[-1].position[:3]) - here
    assert ahead == pytest.approx([0.1, -0.1, 0.01], rel=1e-6)
    assert applied == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize("stamp", [0, -1, -60 * MS, -250 * MS, 50 * MS])
def test_joints_with_invalid_stamps_are_rejected(stamp: int) -> None:
    """No stamp, a repeated one, an old one, and one in the future."""
    lab, arm = moving_arm()
    before, stale = arm.measure(), arm.command_counts().stale
    newest = [message for topic, message in lab.network.sent if topic == "PSM1/measured_js"][-1]
    real = {0: 0, -1: newest.stamp}.get(stamp, EPOCH + lab.now + stamp)
    forged = replace(newest, stamp=real, position=(0.0,) * 6)
    endpoint = lab.network.endpoint("device")
    endpoint.publish(messages.MEASURED_JS.under("PSM1"), forged)
    after = arm.measure()
    assert after.time == before.time and after.q.tolist() == before.q.tolist()
    assert arm.command_counts().stale == stale + 1


@pytest.mark.parametrize("bad", [(np.nan,) * 6, (0.1, 0.2), ()])
def test_invalid_joints_are_rejected(bad: tuple[float, ...]) -> None:
    lab, arm = moving_arm()
    before = arm.measure()
    endpoint = lab.network.endpoint("device")
    endpoint.publish(
        messages.MEASURED_JS.under("PSM1"), messages.JointState(lab.real() + 1, (), bad)
    )
    assert arm.measure().time == before.time


def test_commands_without_a_recent_position_are_withheld_and_counted() -> None:
    lab, arm = moving_arm()
    lab.network.lose = lambda topic, message: topic.endswith("measured_js")
    for _ in range(8):
        lab.tick(arm, RATES)
    count = len(setpoints(lab))
    assert lab.tick(arm, RATES).tolist() == [0.0, 0.0, 0.0]
    assert len(setpoints(lab)) == count and arm.command_counts().withheld > 0
    assert arm.command_counts().sent == count


@pytest.mark.parametrize("change", ["number", "deadline", "nan", "shape"])
def test_an_invalid_command_moves_nothing_and_is_counted(change: str) -> None:
    lab, arm = moving_arm()
    count = len(setpoints(lab))
    now = lab.now
    number = lab.number if change == "number" else lab.number + 1
    deadline = now - 1 if change == "deadline" else now + PATIENCE
    bad = {"nan": np.full(3, np.nan), "shape": np.zeros(2)}.get(change, RATES)
    assert arm.apply(Command(number, now, deadline, bad, True)).tolist() == [0.0, 0.0, 0.0]
    assert len(setpoints(lab)) == count and arm.command_counts().refused == 1


def test_an_arm_without_reports_is_not_enabled() -> None:
    lab = CrtkLab()
    arm = lab.client()
    lab.network.lose = lambda topic, message: topic.endswith("measured_js")
    lab.advance(100 * MS)
    with pytest.raises(NotReady, match="PSM1 does not report its position"):
        arm.enable()
    assert not lab.network.texts("PSM1/state_command")


@pytest.mark.parametrize(
    ("topic", "age", "text"),
    [
        ("measured_js", 60 * MS, "stamps of PSM1/measured_js are 0.060 s old: synchronise"),
        ("measured_js", -1000 * MS, "stamps of PSM1/measured_js are -1.000 s old: synchronise"),
        ("measured_js", None, "PSM1/measured_js has no stamp"),
        ("operating_state", None, "PSM1/operating_state has no stamp"),
        ("operating_state", -1000 * MS, "PSM1/operating_state are -0.990 s old"),
    ],
)
def test_rejected_stamps_are_reported(
    topic: str, age: int | None, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reason appears when connecting, and for the joints also when enabling."""
    monkeypatch.setattr("rcmservo.hardware.crtk.arm.CONNECT_TIMEOUT_S", 0.1)
    lab = CrtkLab()
    before = lab.client("before")
    lab.network.latched.clear()

    def forge(publish: Any) -> Any:
        def forged(to: messages.Topic[Any], message: Any) -> bool:
            stamp = 0 if age is None else message.stamp - age
            forges = to.name.endswith(topic)
            return publish(to, replace(message, stamp=stamp) if forges else message)

        return forged

    endpoint = lab.device._transport
    monkeypatch.setattr(endpoint, "publish", forge(endpoint.publish))
    lab.device.receive_command(messages.StringStamped(lab.real(), "disable"), "console")
    with pytest.raises(NotReady, match=text):
        lab.client()
    if topic == "measured_js":
        lab.advance(60 * MS)
        with pytest.raises(NotReady, match=f"does not report its position: .*{text}"):
            before.enable()


def test_an_enable_that_fails_is_undone() -> None:
    """The arm switches on, and its report is lost."""
    lab = CrtkLab()
    arm = lab.client()
    lab.network.lose = lambda topic, message: topic.endswith("operating_state")
    with pytest.raises(NotReady, match="PSM1 does not switch on"):
        arm.enable()
    assert lab.network.texts("PSM1/state_command") == ["enable", "disable"]
    assert lab.device.state == "DISABLED"
    lab.advance(10 * MS)
    assert lab.tick(arm, RATES).tolist() == [0.0, 0.0, 0.0] and not setpoints(lab)


def test_an_arm_that_is_on_is_switched_off_before_it_is_enabled() -> None:
    lab = CrtkLab()
    arm = lab.client()
    lab.device.receive_command(messages.StringStamped(lab.real(), "enable"), "console")
    arm.enable()
    assert lab.network.texts("PSM1/state_command") == ["disable", "enable"]
    lab.tick(arm, RATES)
    assert arm.command_counts().sent == 1


@pytest.mark.parametrize(
    ("word", "text"), [("unhome", "is not homed"), ("fault", "is FAULT: an operator must clear")]
)
def test_a_refused_enable_reports_the_reason(word: str, text: str) -> None:
    lab = CrtkLab()
    arm = lab.client()
    lab.device.receive_command(messages.StringStamped(lab.real(), word), "console")
    with pytest.raises(NotReady, match=text):
        arm.enable()
    assert not lab.network.texts("PSM1/state_command")


def test_an_operator_cannot_set_the_position() -> None:
    """The arm homes itself, so the driver refuses before it prompts the operator."""
    lab = CrtkLab()
    arm = lab.client()
    assert arm.is_homed()
    lab.device.receive_command(messages.StringStamped(lab.real(), "unhome"), "console")
    for call in (arm.is_homed, lambda: arm.set_position(START)):
        with pytest.raises(NotReady, match=r"PSM1 takes its position from its own homing: home it"):
            call()


def test_the_reason_of_a_switch_off_contains_the_last_warning() -> None:
    lab, arm = moving_arm()
    lab.device.receive_command(messages.StringStamped(lab.real(), "fault"), "console")
    assert (
        arm.off_reason == "PSM1 changed to FAULT by itself; its last warning: a fault was requested"
    )
    assert not arm.measure().enabled


def test_an_arm_without_a_speed_topic_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcmservo.hardware.crtk.arm.CONNECT_TIMEOUT_S", 0.1)
    with pytest.raises(NotReady, match="nothing subscribes to PSM1/servo_jv"):
        moving_arm(jv=True)


def test_speeds_are_sent_with_jv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulated_transport.Endpoint.count_listeners", lambda endpoint, topic: 1)
    lab, _ = moving_arm(jv=True)
    assert len(speeds(lab)) == 50 and not setpoints(lab)
    assert speeds(lab)[-1].velocity == pytest.approx((0.2, -0.2, 0.02, 0.0, 0.0, 0.0))


def speeds(lab: CrtkLab) -> list[Any]:
    return [message for topic, message in lab.network.sent if topic == "PSM1/servo_jv"]


def test_zero_speed_precedes_the_switch_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulated_transport.Endpoint.count_listeners", lambda endpoint, topic: 1)
    lab, _ = moving_arm(jv=True)
    lab.advance(PATIENCE + 10 * MS)
    own_messages = [
        message for topic, message in lab.network.sent if topic.endswith(("servo_jv", "_command"))
    ]
    assert own_messages[-2] is speeds(lab)[-1] and own_messages[-1].string == "disable"
    assert own_messages[-2].velocity == (0.0,) * 6 and len(speeds(lab)) == 51


def test_an_arm_without_recent_reports_gets_zero_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulated_transport.Endpoint.count_listeners", lambda endpoint, topic: 1)
    lab, arm = moving_arm(jv=True)
    lab.network.lose = lambda topic, message: topic.endswith("measured_js")
    for _ in range(8):
        applied = lab.tick(arm, RATES)
    assert speeds(lab)[-1].velocity == (0.0,) * 6 and not applied.any()
    assert arm.command_counts().withheld > 0 and arm.measure().enabled


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"namespace": "PSM 1"}, "arm.namespace"),
        ({"ros": 3}, "arm.ros"),
        ({"domain": 233}, "arm.domain"),
        ({"interface": "<lo/>"}, "arm.interface"),
        ({"signs": (1.0, 2.0, 1.0)}, "arm.signs"),
        ({"signs": (1.0, float("nan"), 1.0)}, "arm.signs"),
        ({"max_lead": (0.1, 0.1, 0.0)}, "arm.max_lead"),
        ({"max_lead": (0.1, 0.1, float("nan"))}, "arm.max_lead"),
        ({"reply_timeout": float("inf")}, "arm.reply_timeout"),
    ],
)
def test_invalid_settings_are_reported_with_their_field(change: dict[str, Any], field: str) -> None:
    with pytest.raises(BadInput) as refused:
        CrtkSettings(**({"namespace": "PSM1"} | change))
    assert refused.value.field == field


def test_a_silent_client_sends_nothing_until_the_arm_is_switched_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("simulated_transport.Endpoint.count_listeners", lambda endpoint, topic: 1)
    lab, arm = moving_arm(jv=True)
    assert arm.is_rate_controlled
    before = len(lab.network.sent)
    arm.suspend_communication()
    for _ in range(20):
        assert not lab.tick(arm, RATES).any()
    own_messages = [
        topic for topic, _ in lab.network.sent[before:] if "servo" in topic or "command" in topic
    ]
    assert not own_messages
    arm.apply(Command(10_000, lab.now, lab.now, np.zeros(3), False))
    assert lab.network.texts("PSM1/state_command")[-1] == "disable"
