"""Measurement of the drives' gains and lag in the first motion, and its validity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.control.drive_response import (
    DEFAULT_LAG_S,
    EXACT_GAIN,
    MAX_GAIN,
    MAX_LAG_S,
    MIN_GAIN,
    MIN_LAG_S,
    add_response_reading,
    finish_response_measurement,
    select_gain,
    select_lag,
    select_possible_response,
    start_response_measurement,
)
from rcmservo.control.exploration import ExplorationState
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.safety.causes import Cause
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, Drive, Rig, RigSettings
from rcmservo.tracking import PointMarkers

MAX_RATES = np.array([1.0, 1.0, 80.0])
TICK_NS = 10_000_000


def measurement(lag: float, delay: float, gains: Floats, report_ticks: int = 1) -> ExplorationState:
    """Return the measurement of a second of motion to and fro.

    The drives follow their rates times `gains` (3,). Joints are read every `report_ticks` ticks and
    repeated meanwhile.
    """
    state, q, rate, steps = ExplorationState.of(), np.zeros(3), np.zeros(3), 10
    read = q.copy()
    start_response_measurement(state.rows[0])
    commanded = [0.2 * MAX_RATES * np.sign(np.sin(2.0 * np.pi * k / 30 + 0.1)) for k in range(100)]
    delay_ms = round(delay * 1000)
    for k in range(100):
        applied = commanded[k - 1] if k else np.zeros(3)
        read = q.copy() if k % report_ticks == 0 else read
        add_response_reading(state.rows[0], read, (k + 1) * TICK_NS, applied)
        for j in range(steps):
            at = (k * steps + j - delay_ms) // steps
            command = commanded[at] if at >= 0 else np.zeros(3)
            rate += (1.0 - np.exp(-1e-3 / lag)) * (command * gains - rate)
            q = q + 1e-3 * rate
    finish_response_measurement(state.rows[0], MAX_RATES)
    return state


@given(st.floats(0.005, 0.08), st.integers(0, 30))
def test_it_measures_lag_and_delay_together(lag: float, delay_ms: int) -> None:
    """A delay that is long compared with the period of the rates is underestimated.

    Delays are whole ms, as `measurement` needs them.
    """
    delay = delay_ms / 1000
    rel = 0.15 if delay <= 0.02 else 0.2
    assert measurement(lag, delay, np.ones(3)).lag == pytest.approx(lag + delay, rel=rel, abs=2e-3)


def test_a_joint_without_motion_does_not_affect_the_measurement() -> None:
    obeys = np.array([1.0, 0.0, 1.0])
    assert measurement(0.04, 0.0, obeys).lag == pytest.approx(
        measurement(0.04, 0.0, np.ones(3)).lag, abs=1e-3
    )


@pytest.mark.parametrize("obeys", [np.zeros(3), -np.ones(3)])
def test_an_impossible_lag_is_rejected(obeys: Floats) -> None:
    state = measurement(0.04, 0.0, obeys)
    assert state.lag == 0.0
    assert select_lag(state.rows[0], 0.0) == DEFAULT_LAG_S and select_lag(state.rows[0], 0.3) == 0.3


@pytest.mark.parametrize("early", [0.0, 0.01])
def test_a_drive_that_follows_at_once_or_is_read_late_has_the_minimal_lag(early: float) -> None:
    """With the default lag such a drive would stop as NOT_FOLLOWING."""
    state, q = ExplorationState.of(), np.zeros(3)
    start_response_measurement(state.rows[0])
    for k in range(100):
        applied = 0.2 * MAX_RATES * np.sign(np.sin(2.0 * np.pi * k / 30 + 0.1))
        q = q + TICK_NS * 1e-9 * applied
        ahead = q + early * applied
        add_response_reading(state.rows[0], ahead, (k + 1) * TICK_NS, applied)
    finish_response_measurement(state.rows[0], MAX_RATES)
    assert state.lag == MIN_LAG_S == select_lag(state.rows[0], 0.0)


@given(
    st.lists(st.floats(0.65, 1.35), min_size=3, max_size=3),
    st.floats(0.005, 0.15),
    st.integers(0, 10),
)
def test_it_measures_the_gain_of_each_joint_whatever_the_lag(
    gains: list[float], lag: float, delay_ms: int
) -> None:
    """Before the delay was part of the model, 8 ms of it increased the gain by 2 %."""
    state = measurement(lag, 1e-3 * delay_ms, np.array(gains))
    for i in range(3):
        assert select_gain(state.rows[0], i) == pytest.approx(gains[i], abs=0.015)
    assert state.lag == pytest.approx(lag + 1e-3 * delay_ms, rel=0.15, abs=2e-3)


def test_a_gain_near_1_is_1() -> None:
    state = measurement(0.02, 0.0, np.array([1.0 + 0.5 * EXACT_GAIN, 1.0, 1.0 - 0.5 * EXACT_GAIN]))
    assert [select_gain(state.rows[0], i) for i in range(3)] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("gain", [0.0, -1.0, 0.3, 3.0])
def test_a_gain_that_no_sound_drive_has_counts_as_1(gain: float) -> None:
    """The following error then stops the tool."""
    state = measurement(0.02, 0.0, np.array([1.0, gain, 1.0]))
    assert [select_gain(state.rows[0], i) for i in range(3)] == [1.0, 1.0, 1.0]


def test_repeated_joints_leave_gain_and_lag_as_they_are() -> None:
    """An arm that measures at 50 Hz and reports at 100 Hz."""
    state = measurement(0.04, 0.0, np.array([0.9, 1.1, 1.0]), report_ticks=2)
    gains = [select_gain(state.rows[0], i) for i in range(3)]
    np.testing.assert_allclose(gains, [0.9, 1.1, 1.0], atol=0.02)
    assert state.lag == pytest.approx(0.04, rel=0.15)


def test_before_a_measurement_a_drive_may_be_quick_or_slow() -> None:
    def list_responses(state: ExplorationState) -> set[tuple[float, float]]:
        return {select_possible_response(state.rows[0], 0, k, 0.0) for k in range(4)}

    extremes = {(g, T) for g in (MIN_GAIN, MAX_GAIN) for T in (DEFAULT_LAG_S, MAX_LAG_S)}
    assert list_responses(ExplorationState.of(is_measuring=True)) == extremes
    assert list_responses(ExplorationState.of()) == {(1.0, DEFAULT_LAG_S)}
    ((gain, lag),) = list_responses(measurement(0.04, 0.0, np.array([0.8, 1.0, 1.0])))
    assert (gain, lag) == pytest.approx((0.8, 0.04), abs=0.01)


def run_with_drives(
    lag: float,
    thresholds: Thresholds,
    delay: float = Drive().delay,
    rate_error: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[set[Cause], float]:
    """Return the causes that stop an arm with such drives, and its measured lag in s."""
    drive = Drive(delay, lag, rate_error=rate_error)
    settings = RigSettings(drive=drive, point_noise=0.1)
    rig = Rig(1, settings, pictures=False)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    target = teach(plant, frames=30)
    rig.go_home()
    servo = Servo(settings.mechanism, settings.tool, thresholds=thresholds)
    states = [tick.state for tick in servo_ticks(plant, servo, target, 4.0)]
    return {s.cause for s in states if s.cause.stop_sentence}, states[
        -1
    ].estimation.exploration_state.lag


@pytest.mark.parametrize("lag", [0.005, 0.02, 0.06])
def test_an_arm_with_lag_reaches_the_target_with_its_measured_lag(lag: float) -> None:
    causes, measured = run_with_drives(lag, Thresholds())
    assert not causes
    assert measured == pytest.approx(lag + Drive().delay, rel=0.1)


@pytest.mark.parametrize("error", [-0.3, -0.05, 0.3])
@pytest.mark.parametrize("lag", [0.02, 0.146])
def test_drives_that_follow_by_another_ratio_or_slowly_arrive(error: float, lag: float) -> None:
    """A cobot's speed slider at 70 % and a lag of 150 ms, its delay included."""
    causes, measured = run_with_drives(lag, Thresholds(), rate_error=(error, -error, error))
    assert not causes
    assert measured == pytest.approx(lag + Drive().delay, rel=0.15)


def test_an_incorrect_lag_as_a_setting_stops_the_arm() -> None:
    assert not run_with_drives(0.12, Thresholds(drive_lag=0.12))[0]
    assert run_with_drives(0.06, Thresholds(drive_lag=0.01))[0] == {Cause.NOT_FOLLOWING}


@pytest.mark.parametrize("axis", [1, 2, 3])
@pytest.mark.parametrize("factor", [0.0, -1.0])
@pytest.mark.parametrize("at", [0.2, 1.2])
def test_an_axis_that_does_not_follow_is_found(axis: int, factor: float, at: float) -> None:
    """Within 0.25 s while exploring slowly and 0.1 s plus the lag when the lag is measured."""
    disturbance = Disturbance("gain", at, None, {"axis": axis, "factor": factor})
    rig = Rig(1, RigSettings(point_noise=0.1), False, [disturbance])
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    target = teach(plant, frames=30)
    rig.go_home()
    rig.begin()
    start = rig.clock.now()
    for tick in servo_ticks(plant, Servo(rig.mechanism, rig.tool), target, 4.0):
        if tick.state.cause is Cause.NOT_FOLLOWING:
            break
    else:
        pytest.fail("not found")
    assert f"joint {axis}" in tick.state.detail
    delay_ns = tick.observation.now - start - round(at * 1e9)
    assert delay_ns < (600_000_000 if at < 1.0 else 400_000_000)


@pytest.mark.parametrize("delay", [0.02, 0.04])
def test_an_arm_with_delay_does_not_oscillate_about_an_exploration_corner(delay: float) -> None:
    """Without longer braking the joints pass a corner one by one, and never reach it together."""
    lag = 0.02
    for known in (0.0, lag + delay):
        causes, measured = run_with_drives(lag, Thresholds(drive_lag=known), delay)
        assert not causes
        assert measured == pytest.approx(lag + delay, rel=0.25)
