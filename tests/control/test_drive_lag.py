"""Measurement of the drives' lag in the first motion, and its validity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.control.drive_lag import (
    DEFAULT_LAG_S,
    MAX_LAG_S,
    MIN_LAG_S,
    add_lag_reading,
    finish_lag_measurement,
    select_lag,
    start_lag_measurement,
)
from rcmservo.control.exploration import ExplorationState
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.safety.causes import Cause
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo
from rcmservo.sim import Drive, Rig, RigSettings
from rcmservo.tracking import PointMarkers

MAX_RATES = np.array([1.0, 1.0, 80.0])
TICK_NS = 10_000_000


def measurement(lag: float, delay: float, obeys: Floats) -> ExplorationState:
    """Return the measurement of a second of motion to and fro.

    Only the drives with 1 in `obeys` (3,) follow their rates.
    """
    state, q, rate, steps = ExplorationState.of(), np.zeros(3), np.zeros(3), 10
    start_lag_measurement(state.rows[0])
    commanded = [0.2 * MAX_RATES * np.sign(np.sin(2.0 * np.pi * k / 30 + 0.1)) for k in range(100)]
    delay_ms = round(delay * 1000)
    for k in range(100):
        applied = commanded[k - 1] if k else np.zeros(3)
        add_lag_reading(state.rows[0], q.copy(), (k + 1) * TICK_NS, applied, MAX_RATES)
        for j in range(steps):
            at = (k * steps + j - delay_ms) // steps
            command = commanded[at] if at >= 0 else np.zeros(3)
            rate += (1.0 - np.exp(-1e-3 / lag)) * (command * obeys - rate)
            q = q + 1e-3 * rate
    finish_lag_measurement(state.rows[0])
    return state


@given(st.floats(0.005, 0.08), st.integers(0, 30))
def test_it_measures_lag_and_delay_together(lag: float, delay_ms: int) -> None:
    """A delay that is long compared with the period of the rates is underestimated.

    Delays are whole ms, as `measurement` needs them.
    """
    delay = delay_ms / 1000
    rel = 0.12 if delay <= 0.02 else 0.18
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
    start_lag_measurement(state.rows[0])
    for k in range(100):
        applied = 0.2 * MAX_RATES * np.sign(np.sin(2.0 * np.pi * k / 30 + 0.1))
        q = q + TICK_NS * 1e-9 * applied
        ahead = q + early * applied
        add_lag_reading(state.rows[0], ahead, (k + 1) * TICK_NS, applied, MAX_RATES)
    finish_lag_measurement(state.rows[0])
    assert state.lag == MIN_LAG_S == select_lag(state.rows[0], 0.0)


def run_with_drives(
    lag: float, thresholds: Thresholds, delay: float = Drive().delay
) -> tuple[set[Cause], float]:
    """Return the causes that stop an arm with such drives, and its measured lag in s."""
    settings = RigSettings(drive=Drive(delay, lag), point_noise=0.1)
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


def test_a_slower_arm_needs_its_lag_as_a_setting_and_an_incorrect_one_stops_it() -> None:
    assert run_with_drives(0.12, Thresholds())[0] == {Cause.NOT_FOLLOWING}
    assert not run_with_drives(0.12, Thresholds(drive_lag=0.12))[0]
    assert run_with_drives(0.06, Thresholds(drive_lag=0.01))[0] == {Cause.NOT_FOLLOWING}
    assert MAX_LAG_S > 0.12


@pytest.mark.parametrize("delay", [0.02, 0.04])
def test_an_arm_with_delay_does_not_oscillate_about_an_exploration_corner(delay: float) -> None:
    """Without longer braking the joints pass a corner one by one, and never reach it together."""
    lag = 0.02
    for known in (0.0, lag + delay):
        causes, measured = run_with_drives(lag, Thresholds(drive_lag=known), delay)
        assert not causes
        assert measured == pytest.approx(lag + delay, rel=0.25)
