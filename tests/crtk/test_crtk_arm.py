"""What the client of a CRTK arm sends, and what it believes, on an injected clock."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated_wire import EPOCH, LIMITS, MS, PATIENCE, RATES, START, TICK, CrtkLab, driven, sent

from rcmservo.errors import BadInput
from rcmservo.hardware.crtk import messages as m
from rcmservo.hardware.crtk.lead import JUMP, LONGEST_STEP, Lead
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.interfaces import Command
from rcmservo.live.lab import NotReady

rates = st.tuples(*(st.floats(-2.0, 2.0) for _ in range(3)))


def test_it_reads_joints_in_its_own_units_and_the_arm_is_off() -> None:
    told = CrtkLab().client().measure()
    assert told.q == pytest.approx(START) and not told.enabled


def test_rates_become_positions_in_rad_and_m_and_the_wrist_is_held_still() -> None:
    lab, arm = driven()
    moved = arm.measure().q - START
    assert moved == pytest.approx(RATES * 0.5, rel=0.2)
    last = sent(lab)[-1]
    assert last.position[:3] == pytest.approx((START + RATES * 0.5) * [1.0, 1.0, 1e-3], rel=1e-2)
    assert last.position[3:] == (0.0, 0.0, 0.0) and len(last.name) == 6
    assert arm.account().sent == 50 and arm.account().warned == 0


def test_signs_turn_joints_both_ways() -> None:
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
def test_what_is_asked_for_never_leads_by_more_than_the_lead(
    steps: list[tuple[Any, int, Any]], lead: Any, wild: float
) -> None:
    """Whatever the arm does or tells meanwhile, however long the loop stood; and what was taken is
    how the setpoint moved, which never jumps."""
    setpoint = Lead(np.array(lead), LIMITS)
    now, last, measured = 0, 0, START.copy()
    before = START.copy()
    setpoint.anchor(START, now)
    for wanted, late, pushed in steps:
        now += late * MS
        measured = measured + np.array(pushed) * wild
        step = setpoint.step(np.array(wanted), measured, now)
        if step is None:
            assert wild > 0.01
            continue
        held, took = step
        passed, last = now - last, now
        asked = np.abs(wanted) * min(passed, LONGEST_STEP) * 1e-9
        assert (np.abs(held - before) <= asked + JUMP + 1e-9).all()
        assert (np.abs(held - measured) <= np.array(lead) + 1e-9).all()
        if passed:
            assert took * passed * 1e-9 == pytest.approx(held - before, abs=1e-9)
        before = held


def test_it_asks_for_nothing_beyond_the_limits() -> None:
    lead = Lead(np.full(3, 10.0), LIMITS)
    lead.anchor(np.array(LIMITS.upper), 0)
    step = lead.step(np.full(3, 1.0), np.array(LIMITS.upper), TICK)
    assert step is not None and (step[0] < LIMITS.upper).all()


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_place_that_cannot_be_moves_nothing_and_it_is_switched_off(way: float) -> None:
    """Fresh and finite, and one joint of it is wild."""
    lab, arm = driven()
    count, last = len(sent(lab)), sent(lab)[-1]
    told = (last.position[0] + way, *last.position[1:])
    lab.wire.end("device").publish(
        m.MEASURED_JS.under("PSM1"), m.JointState(lab.real() + MS, (), told)
    )
    assert not lab.tick(arm, RATES).any()
    assert len(sent(lab)) == count and lab.device.state == "DISABLED"
    assert "told a place far from where it was asked to be" in arm.why_off
    assert arm.account().withheld == 1


def test_a_look_that_comes_late_takes_what_it_really_takes() -> None:
    lab, arm = driven()
    lab.let_pass(30 * MS)
    took = lab.tick(arm, RATES)
    assert took == pytest.approx(RATES * 20.0 / 40.0, rel=1e-6)


def test_an_arm_that_is_held_up_is_asked_for_no_more_than_the_lead_after_a_stall() -> None:
    lab, arm = driven()
    lab.joints.step = lambda rates, on, time: lab.joints.q  # type: ignore[method-assign]
    here = lab.joints.q * [1.0, 1.0, 1e-3]
    for _ in range(100):
        took = lab.tick(arm, RATES)
    ahead = np.array(sent(lab)[-1].position[:3]) - here
    assert ahead == pytest.approx([0.1, -0.1, 0.01], rel=1e-6)
    assert took == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize("stamp", [0, -1, -60 * MS, -250 * MS, 50 * MS])
def test_joints_with_stamps_that_cannot_be_are_no_news(stamp: int) -> None:
    """None, the same again, an old one, one to come."""
    lab, arm = driven()
    before, stale = arm.measure(), arm.account().stale
    newest = [said for topic, said in lab.wire.said if topic == "PSM1/measured_js"][-1]
    real = {0: 0, -1: newest.stamp}.get(stamp, EPOCH + lab.now + stamp)
    forged = replace(newest, stamp=real, position=(0.0,) * 6)
    end = lab.wire.end("device")
    end.publish(m.MEASURED_JS.under("PSM1"), forged)
    after = arm.measure()
    assert after.time == before.time and after.q.tolist() == before.q.tolist()
    assert arm.account().stale == stale + 1


@pytest.mark.parametrize("bad", [(np.nan,) * 6, (0.1, 0.2), ()])
def test_joints_that_are_none_are_no_news(bad: tuple[float, ...]) -> None:
    lab, arm = driven()
    before = arm.measure()
    end = lab.wire.end("device")
    end.publish(m.MEASURED_JS.under("PSM1"), m.JointState(lab.real() + 1, (), bad))
    assert arm.measure().time == before.time


def test_it_withholds_what_it_cannot_anchor_and_counts_it() -> None:
    lab, arm = driven()
    lab.wire.lose = lambda topic, said: topic.endswith("measured_js")
    for _ in range(8):
        lab.tick(arm, RATES)
    count = len(sent(lab))
    assert lab.tick(arm, RATES).tolist() == [0.0, 0.0, 0.0]
    assert len(sent(lab)) == count and arm.account().withheld > 0
    assert arm.account().sent == count


@pytest.mark.parametrize("change", ["number", "deadline", "nan", "shape"])
def test_a_void_command_moves_nothing_and_is_counted(change: str) -> None:
    lab, arm = driven()
    count = len(sent(lab))
    now = lab.now
    number = lab.number if change == "number" else lab.number + 1
    deadline = now - 1 if change == "deadline" else now + PATIENCE
    bad = {"nan": np.full(3, np.nan), "shape": np.zeros(2)}.get(change, RATES)
    assert arm.apply(Command(number, now, deadline, bad, True)).tolist() == [0.0, 0.0, 0.0]
    assert len(sent(lab)) == count and arm.account().refused == 1


def test_an_arm_that_says_nothing_is_not_enabled() -> None:
    lab = CrtkLab()
    arm = lab.client()
    lab.wire.lose = lambda topic, said: topic.endswith("measured_js")
    lab.let_pass(100 * MS)
    with pytest.raises(NotReady, match="PSM1 does not say where it is"):
        arm.enable()
    assert not lab.wire.words("PSM1/state_command")


@pytest.mark.parametrize(
    ("topic", "age", "words"),
    [
        ("measured_js", 60 * MS, "stamps of PSM1/measured_js are 0.060 s old: its clock"),
        ("measured_js", -1000 * MS, "stamps of PSM1/measured_js are -1.000 s old: its clock"),
        ("measured_js", None, "PSM1/measured_js bears no stamp"),
        ("operating_state", None, "PSM1/operating_state bears no stamp"),
        ("operating_state", -1000 * MS, "PSM1/operating_state are -0.990 s old"),
    ],
)
def test_stamps_that_are_not_believed_are_told_as_that(
    topic: str, age: int | None, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When it connects, and of the joints when it is to be enabled."""
    monkeypatch.setattr("rcmservo.hardware.crtk.arm.FOUND_WITHIN", 0.1)
    lab = CrtkLab()
    before = lab.client("before")
    lab.wire.kept.clear()

    def forge(publish: Any) -> Any:
        def forged(to: m.Topic[Any], said: Any) -> bool:
            stamp = 0 if age is None else said.stamp - age
            return publish(to, replace(said, stamp=stamp) if to.name.endswith(topic) else said)

        return forged

    end = lab.device._transport
    monkeypatch.setattr(end, "publish", forge(end.publish))
    lab.device.hear_command(m.StringStamped(lab.real(), "disable"), "console")
    with pytest.raises(NotReady, match=words):
        lab.client()
    if topic == "measured_js":
        lab.let_pass(60 * MS)
        with pytest.raises(NotReady, match=f"does not say where it is: .*{words}"):
            before.enable()


def test_an_enable_that_fails_is_undone() -> None:
    """The arm goes on, and its word of that is lost."""
    lab = CrtkLab()
    arm = lab.client()
    lab.wire.lose = lambda topic, said: topic.endswith("operating_state")
    with pytest.raises(NotReady, match="PSM1 does not switch on"):
        arm.enable()
    assert lab.wire.words("PSM1/state_command") == ["enable", "disable"]
    assert lab.device.state == "DISABLED"
    lab.let_pass(10 * MS)
    assert lab.tick(arm, RATES).tolist() == [0.0, 0.0, 0.0] and not sent(lab)


def test_an_arm_that_somebody_left_on_is_switched_off_first() -> None:
    lab = CrtkLab()
    arm = lab.client()
    lab.device.hear_command(m.StringStamped(lab.real(), "enable"), "console")
    arm.enable()
    assert lab.wire.words("PSM1/state_command") == ["disable", "enable"]
    lab.tick(arm, RATES)
    assert arm.account().sent == 1


@pytest.mark.parametrize(
    ("word", "words"), [("unhome", "is not homed"), ("fault", "is FAULT: a person must clear")]
)
def test_an_arm_that_cannot_be_enabled_says_why(word: str, words: str) -> None:
    lab = CrtkLab()
    arm = lab.client()
    lab.device.hear_command(m.StringStamped(lab.real(), word), "console")
    with pytest.raises(NotReady, match=words):
        arm.enable()
    assert not lab.wire.words("PSM1/state_command")


def test_it_homes_itself() -> None:
    """A person is not asked where it stands, to be refused."""
    lab = CrtkLab()
    arm = lab.client()
    assert arm.homed()
    lab.device.hear_command(m.StringStamped(lab.real(), "unhome"), "console")
    for told in (arm.homed, lambda: arm.define(START)):
        with pytest.raises(NotReady, match=r"PSM1 knows where .* own homing: home it there"):
            told()


def test_why_it_went_off_names_the_last_warning() -> None:
    lab, arm = driven()
    lab.device.hear_command(m.StringStamped(lab.real(), "fault"), "console")
    assert arm.why_off == "PSM1 went FAULT by itself; it said last: a fault was asked for"
    assert not arm.measure().enabled


def test_an_arm_that_takes_no_speeds_is_not_sent_any(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcmservo.hardware.crtk.arm.FOUND_WITHIN", 0.1)
    with pytest.raises(NotReady, match="nobody hears PSM1/servo_jv"):
        driven(jv=True)


def test_speeds_are_sent_only_where_the_lab_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulated_wire.End.listeners", lambda end, topic: 1)
    lab, _ = driven(jv=True)
    said = [said for topic, said in lab.wire.said if topic == "PSM1/servo_jv"]
    assert len(said) == 50 and not sent(lab)
    assert said[-1].velocity == pytest.approx((0.2, -0.2, 0.02, 0.0, 0.0, 0.0))


def speeds(lab: CrtkLab) -> list[Any]:
    return [said for topic, said in lab.wire.said if topic == "PSM1/servo_jv"]


def test_before_it_is_switched_off_it_is_sent_the_speed_zero(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("simulated_wire.End.listeners", lambda end, topic: 1)
    lab, _ = driven(jv=True)
    lab.let_pass(PATIENCE + 10 * MS)
    ours = [said for topic, said in lab.wire.said if topic.endswith(("servo_jv", "_command"))]
    assert ours[-2] is speeds(lab)[-1] and ours[-1].string == "disable"
    assert ours[-2].velocity == (0.0,) * 6 and len(speeds(lab)) == 51


def test_an_arm_that_is_not_heard_is_sent_the_speed_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulated_wire.End.listeners", lambda end, topic: 1)
    lab, arm = driven(jv=True)
    lab.wire.lose = lambda topic, said: topic.endswith("measured_js")
    for _ in range(8):
        took = lab.tick(arm, RATES)
    assert speeds(lab)[-1].velocity == (0.0,) * 6 and not took.any()
    assert arm.account().withheld > 0 and arm.measure().enabled


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"namespace": "PSM 1"}, "arm.namespace"),
        ({"ros": 3}, "arm.ros"),
        ({"domain": 233}, "arm.domain"),
        ({"interface": "<lo/>"}, "arm.interface"),
        ({"signs": (1.0, 2.0, 1.0)}, "arm.signs"),
        ({"signs": (1.0, float("nan"), 1.0)}, "arm.signs"),
        ({"lead": (0.1, 0.1, 0.0)}, "arm.lead"),
        ({"lead": (0.1, 0.1, float("nan"))}, "arm.lead"),
        ({"answer_within": float("inf")}, "arm.answer_within"),
    ],
)
def test_settings_that_cannot_be_are_named(change: dict[str, Any], field: str) -> None:
    with pytest.raises(BadInput) as told:
        CrtkSettings(**({"namespace": "PSM1"} | change))
    assert told.value.field == field


def test_left_alone_it_says_nothing_until_it_is_switched_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("simulated_wire.End.listeners", lambda end, topic: 1)
    lab, arm = driven(jv=True)
    assert arm.by_speeds
    before = len(lab.wire.said)
    arm.fall_silent()
    for _ in range(20):
        assert not lab.tick(arm, RATES).any()
    ours = [topic for topic, _ in lab.wire.said[before:] if "servo" in topic or "command" in topic]
    assert not ours
    arm.apply(Command(10_000, lab.now, lab.now, np.zeros(3), False))
    assert lab.wire.words("PSM1/state_command")[-1] == "disable"
