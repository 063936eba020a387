"""Jogging: the joints move at the requested rates, only while requested, and within the limits.

The image does not matter. A fault of the arm ends it, and all of it is recorded.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rcmservo as rs
from conftest import Laboratory, make_laboratory
from rcmservo.interfaces import Floats
from rcmservo.loop.operator import OperatorRequest
from rcmservo.recording import reader
from rcmservo.recording.replay import replay_record
from rcmservo.recording.timeline import list_spans
from rcmservo.recording.writer import Recorder
from rcmservo.safety.state_machine import SLOW_SPEED_SCALE
from rcmservo.sim import Disturbance

RATES = np.array([0.1, -0.08, 9.0])
"""Joint rates below a fifth of the limits."""
JOG = rs.Jog(RATES)
BEGIN, END = 0.5, 1.5
"""Times in s between which the operator jogs."""
COME_TO_REST = 0.15
"""Time in s after which nothing moves."""


def scripted_request(
    tick: rs.Tick, *requests: tuple[float, float, OperatorRequest]
) -> OperatorRequest:
    """Return the request for the next tick; each request has its begin and end time in s."""
    now = tick.time * 1e-9 + 0.01
    present = (request for begin, end, request in requests if begin <= now < end - 1e-9)
    return next(present, rs.Request.NONE)


def pause_and_jog(
    request: OperatorRequest = JOG, begin: float = BEGIN, end: float = END
) -> Callable[[rs.Tick], OperatorRequest]:
    """Return an operator that pauses at once and jogs for a while."""
    return lambda tick: scripted_request(tick, (0.0, 0.02, rs.Request.PAUSE), (begin, end, request))


def ticks_of(
    lab: Laboratory, operator: Callable[[rs.Tick], OperatorRequest], seconds: float = 3.0
) -> list[rs.Tick]:
    return list(rs.servo_ticks(lab.plant, lab.servo(), lab.target, seconds, operator=operator))


def phases(ticks: list[rs.Tick]) -> list[rs.Phase]:
    """Return the successive phases."""
    all_of = [tick.state.phase for tick in ticks]
    return [one for i, one in enumerate(all_of) if i == 0 or all_of[i - 1] is not one]


def at(ticks: list[rs.Tick], time: float) -> rs.Tick:
    return min(ticks, key=lambda tick: abs(tick.time * 1e-9 - time))


def moved(ticks: list[rs.Tick], begin: float, end: float) -> Floats:
    return at(ticks, end).observation.q - at(ticks, begin).observation.q


def hide_markers(lab: Laboratory) -> None:
    """Replace the tracker by one that detects nothing."""
    lab.plant.tracker = BlindTracker()


class BlindTracker:
    """Tracker that detects no marker."""

    def find(self, frame: rs.Frame) -> rs.Markers:
        return rs.Markers(np.full((2, 2), np.nan), np.full(2, np.nan), np.zeros(2))

    def reset(self) -> None:
        """Do nothing, as there is no state."""


@pytest.mark.parametrize("markers_visible", [True, False])
def test_the_joints_move_as_requested_and_then_the_servo_is_paused(
    markers_visible: bool,
) -> None:
    lab = make_laboratory()
    if not markers_visible:
        hide_markers(lab)
    ticks = ticks_of(lab, pause_and_jog())
    assert phases(ticks) == [rs.Phase.IDLE, rs.Phase.PAUSED, rs.Phase.JOG, rs.Phase.PAUSED]
    jogged = [tick.time * 1e-9 for tick in ticks if tick.state.phase is rs.Phase.JOG]
    assert jogged[0] == pytest.approx(BEGIN) and jogged[-1] == pytest.approx(END - 0.01)
    np.testing.assert_allclose(moved(ticks, 0.0, 3.0), RATES * (END - BEGIN), rtol=0.03)
    assert not moved(ticks, 0.0, BEGIN).any()
    assert np.abs(moved(ticks, END + COME_TO_REST, 3.0)).max() < 2.5e-3
    afterwards = [tick for tick in ticks if tick.time * 1e-9 >= END + 0.03]
    assert not any(tick.state.command.rates.any() for tick in afterwards)


def test_jogging_is_possible_in_idle_without_detected_markers() -> None:
    lab = make_laboratory()
    hide_markers(lab)
    ticks = ticks_of(lab, lambda tick: scripted_request(tick, (BEGIN, END, rs.Jog(RATES))))
    assert phases(ticks) == [rs.Phase.IDLE, rs.Phase.JOG, rs.Phase.PAUSED]
    np.testing.assert_allclose(moved(ticks, 0.0, 3.0), RATES * (END - BEGIN), rtol=0.03)


@pytest.mark.parametrize("phase", [rs.Phase.ACQUIRE, rs.Phase.SERVO])
def test_a_jog_is_ignored_while_the_servo_moves_the_arm(phase: rs.Phase) -> None:
    plain = ticks_of(make_laboratory(), lambda tick: rs.Request.NONE)
    first = next(i for i, tick in enumerate(plain) if tick.state.phase is phase) + 5

    def operator(tick: rs.Tick) -> OperatorRequest:
        now = round(tick.time * 1e-7)
        return rs.Jog(RATES) if first <= now < first + 10 else rs.Request.NONE

    ticks = ticks_of(make_laboratory(), operator)
    assert ticks[first + 5].request is rs.Request.JOG
    for one, other in zip(plain, ticks, strict=True):
        assert one.state.command.rates.tobytes() == other.state.command.rates.tobytes()


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(-1e6, 1e6)] * 3))
def test_jogging_is_limited_to_a_fifth_of_the_speed_in_the_requested_direction(
    requested: tuple[float, float, float],
) -> None:
    lab = make_laboratory()
    servo, rates = lab.servo(), np.array(requested)
    ticks = ticks_of(lab, pause_and_jog(rs.Jog(rates), end=0.8), 1.0)
    limit = SLOW_SPEED_SCALE * np.array(servo.gate.speed)
    commands = np.array([tick.state.command.rates for tick in ticks])
    assert (np.abs(commands) <= limit * (1.0 + 1e-9)).all()
    steps = np.abs(np.diff(commands, axis=0))
    assert (steps <= np.array(servo.gate.slew) * 0.01 * (1.0 + 1e-9)).all()
    steady = at(ticks, 0.75).state.command.rates
    np.testing.assert_allclose(steady, rates / max(1.0, (np.abs(rates) / limit).max()), atol=1e-12)


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_jogging_stops_at_a_joint_limit_and_can_leave_it(joint: int, sign: float) -> None:
    lab = make_laboratory()
    lower, upper = lab.servo().mechanism.limits.arrays
    rates = np.zeros(3)
    rates[joint] = sign * SLOW_SPEED_SCALE * np.array(lab.servo().gate.speed)[joint]
    far = (upper if sign > 0.0 else lower)[joint] - lab.rig.scene.start[joint]
    ends = 1.0 + abs(far / rates[joint]) + 1.0

    def operator(tick: rs.Tick) -> OperatorRequest:
        jogs = (0.5, ends, rs.Jog(rates)), (ends + 0.5, ends + 1.5, rs.Jog(-rates))
        return scripted_request(tick, (0.0, 0.02, rs.Request.PAUSE), *jogs)

    ticks = ticks_of(lab, operator, ends + 2.0)
    q = np.array([tick.observation.q for tick in ticks])
    slack = lab.servo().thresholds.limit_tolerance
    assert (lower - slack <= q).all() and (q <= upper + slack).all()
    assert abs(
        at(ticks, ends).observation.q[joint] - (upper if sign > 0.0 else lower)[joint]
    ) < 0.02 * max(1.0, abs(far))
    np.testing.assert_allclose(
        moved(ticks, ends + 0.4, ends + 2.0)[joint], -rates[joint], rtol=0.05
    )
    assert rs.Phase.FAULT not in phases(ticks)


IMAGE_DISTURBANCES = (
    "occlusion:at=0.8",
    "decoy:at=0.8",
    "freeze:at=0.8",
    "swap:at=0.8",
    "camera_pan:at=0.8",
    "relocate:at=0.8",
    "frame_drop:at=0.8,share=1",
    "frame_order:at=0.8",
    "camera_clock:at=0.8,s=3600",
    "corrupt:at=0.8,what=none",
    "disk_full:at=0.8",
)
CAUSES_THAT_END_JOGGING = {
    **{
        f"{kind},axis={axis}": (rs.Phase.FAULT, rs.Cause.NOT_FOLLOWING)
        for kind in (
            *(f"gain:at=0.8,factor={factor}" for factor in (0, -1, 3)),
            "encoder:at=0.8",
            "encoder:at=0.8,factor=1,offset=5",
        )
        for axis in (1, 2, 3)
    },
    "encoder_nan:at=0.8,axis=2": (rs.Phase.FAULT, rs.Cause.JOINTS_NOT_FINITE),
    "arm_silent:at=0.8": (rs.Phase.FAULT, rs.Cause.ARM_SILENT),
    "arm_clock:at=0.8": (rs.Phase.FAULT, rs.Cause.DRIVE_OFF),
    "drive_off:at=0.8": (rs.Phase.FAULT, rs.Cause.DRIVE_OFF),
    "stall:at=0.8": (rs.Phase.FAULT, rs.Cause.DRIVE_OFF),
    "jitter:at=0.8,s=0.035": (rs.Phase.PAUSED, rs.Cause.OVERRUN),
}


def disturbed(
    text: str, operator: Callable[[rs.Tick], OperatorRequest], seconds: float
) -> list[rs.Tick]:
    lab = make_laboratory(disturbances=[Disturbance.parse(text)])
    lab.plant.recorded = lambda: not lab.rig.disk_full()
    lab.rig.begin()
    return ticks_of(lab, operator, seconds)


@pytest.mark.parametrize("text", IMAGE_DISTURBANCES)
def test_an_image_disturbance_does_not_end_jogging(text: str) -> None:
    ticks = disturbed(text, pause_and_jog(), 2.0)
    assert phases(ticks)[-2:] == [rs.Phase.JOG, rs.Phase.PAUSED]
    np.testing.assert_allclose(moved(ticks, 0.0, 2.0), RATES * (END - BEGIN), rtol=0.03)


@pytest.mark.parametrize("text", CAUSES_THAT_END_JOGGING)
def test_a_fault_of_the_arm_or_a_late_loop_ends_jogging_at_rest(text: str) -> None:
    ticks = disturbed(text, pause_and_jog(end=0.95), 1.5)
    after = [tick for tick in ticks if tick.time * 1e-9 >= 0.8]
    ended = next(tick for tick in after if tick.state.phase is not rs.Phase.JOG)
    assert (ended.state.phase, ended.state.cause) == CAUSES_THAT_END_JOGGING[text]
    assert ended.time * 1e-9 < 0.95
    rates = [tick.state.command.rates for tick in ticks if tick.time * 1e-9 >= 1.0]
    assert not np.any(rates)


def test_after_jogging_the_servo_continues_to_its_target() -> None:
    def operator(tick: rs.Tick) -> OperatorRequest:
        jog = (6.0, 6.02, rs.Request.PAUSE), (6.5, 7.5, rs.Jog(RATES))
        return scripted_request(tick, *jog, (8.0, 8.01, rs.Request.RESUME))

    lab = make_laboratory()
    ticks = ticks_of(lab, operator, 14.0)
    assert phases(ticks)[2:] == [
        rs.Phase.SERVO,
        rs.Phase.PAUSED,
        rs.Phase.JOG,
        rs.Phase.PAUSED,
        rs.Phase.ACQUIRE,
        rs.Phase.SERVO,
    ]
    errors = [np.linalg.norm(tick.state.delta / (0.02, 1.5, 1.5)) for tick in ticks]
    assert errors[590] < 1.0 and errors[790] > 5.0 and errors[-1] < 1.0
    assert all(tick.state.explored for tick in ticks[600:])


def test_a_camera_moved_during_jogging_is_reported_afterwards() -> None:
    def operator(tick: rs.Tick) -> OperatorRequest:
        return scripted_request(tick, (4.0, 4.02, rs.Request.PAUSE), (4.5, 5.5, rs.Jog(RATES)))

    lab = make_laboratory(disturbances=[Disturbance.parse("relocate:at=5")])
    lab.rig.begin()
    ticks = ticks_of(lab, operator, 7.0)
    assert phases(ticks)[-2:] == [rs.Phase.JOG, rs.Phase.PAUSED]
    assert ticks[-1].state.cause in (rs.Cause.CAMERA_MOVED, rs.Cause.TARGET_OLD)


def test_jogging_is_recorded_in_one_span_and_replays_bit_for_bit(
    tmp_path: Path,
) -> None:
    lab = make_laboratory()
    with Recorder(tmp_path / reader.RECORD, {}) as recorder:
        recorder.begin(lab.servo(), lab.target)
        for tick in ticks_of(lab, pause_and_jog()):
            recorder.write(tick)
    replayed = replay_record(tmp_path)
    assert replayed.same, replayed.sentence
    jog = replayed.recorded.ticks["jog"]
    during = np.array(replayed.recorded.words["request"]) == "JOG"
    assert during.sum() == round(100 * (END - BEGIN))
    assert (jog[during] == RATES).all() and not jog[~during].any()
    jog_spans = [span for span in list_spans(replayed.recorded) if span.phase is rs.Phase.JOG]
    assert len(jog_spans) == 1 and jog_spans[0].duration == pytest.approx(END - BEGIN)
    other = replace(replayed.recorded, ticks={**replayed.recorded.ticks, "jog": np.zeros_like(jog)})
    assert "command" in replay_record(other).difference_counts


def test_rates_must_be_three_finite_numbers() -> None:
    for rates in ([0.1, np.nan, 0.0], [0.1, 0.2], np.inf):
        with pytest.raises(rs.BadInput, match=r"jog\.rates must be three finite numbers"):
            rs.Jog(rates)  # type: ignore[arg-type]
    with pytest.raises(rs.BadInput, match="a Jog, with the joint rates"):
        ticks_of(make_laboratory(), lambda tick: rs.Request.JOG)
