"""The lag of the drives, measured by the first motion, and what is believed of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.control.drive_lag import (
    DEFAULT_LAG_S,
    MAX_LAG_S,
    MIN_LAG_S,
    begin_lag,
    follow_drives,
    lag_of,
    measure_lag,
)
from rcmservo.control.exploration import Exploring
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import run
from rcmservo.loop.teach import teach
from rcmservo.safety.causes import Cause
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo
from rcmservo.sim import Drive, Rig, RigSettings
from rcmservo.tracking import PointMarkers

FASTEST = np.array([1.0, 1.0, 80.0])
TICK = 10_000_000


def told(lag: float, delay: float, moves: Floats) -> Exploring:
    """What a second of going back and forth tells of drives of which only those that are 1 in
    `moves` (3,) obey.
    """
    tour, q, rate, steps = Exploring.of(), np.zeros(3), np.zeros(3), 10
    begin_lag(tour.rows[0])
    asked = [0.2 * FASTEST * np.sign(np.sin(2.0 * np.pi * k / 30 + 0.1)) for k in range(100)]
    late = round(delay * 1000)
    for k in range(100):
        applied = asked[k - 1] if k else np.zeros(3)
        follow_drives(tour.rows[0], q.copy(), (k + 1) * TICK, applied, FASTEST)
        for j in range(steps):
            at = (k * steps + j - late) // steps
            wanted = asked[at] if at >= 0 else np.zeros(3)
            rate += (1.0 - np.exp(-1e-3 / lag)) * (wanted * moves - rate)
            q = q + 1e-3 * rate
    measure_lag(tour.rows[0])
    return tour


@given(st.floats(0.005, 0.08), st.integers(0, 30))
def test_it_measures_lag_and_delay_together(lag: float, late: int) -> None:
    """A delay that is long beside the time from one change of the rates to the next comes out
    short. Delays are whole ms, as `told` takes them.
    """
    delay = late / 1000
    rel = 0.12 if delay <= 0.02 else 0.18
    assert told(lag, delay, np.ones(3)).lag == pytest.approx(lag + delay, rel=rel, abs=2e-3)


def test_a_joint_that_does_not_move_tells_nothing_and_the_others_do() -> None:
    moves = np.array([1.0, 0.0, 1.0])
    assert told(0.04, 0.0, moves).lag == pytest.approx(told(0.04, 0.0, np.ones(3)).lag, abs=1e-3)


@pytest.mark.parametrize("moves", [np.zeros(3), -np.ones(3)])
def test_what_cannot_be_a_lag_is_not_believed(moves: Floats) -> None:
    tour = told(0.04, 0.0, moves)
    assert tour.lag == 0.0
    assert lag_of(tour.rows[0], 0.0) == DEFAULT_LAG_S and lag_of(tour.rows[0], 0.3) == 0.3


@pytest.mark.parametrize("early", [0.0, 0.01])
def test_a_drive_that_follows_at_once_or_is_told_late_is_believed_to(early: float) -> None:
    """It was taken for one that lags by what is supposed, and stopped for not following."""
    tour, q = Exploring.of(), np.zeros(3)
    begin_lag(tour.rows[0])
    for k in range(100):
        applied = 0.2 * FASTEST * np.sign(np.sin(2.0 * np.pi * k / 30 + 0.1))
        q = q + TICK * 1e-9 * applied
        ahead = q + early * applied
        follow_drives(tour.rows[0], ahead, (k + 1) * TICK, applied, FASTEST)
    measure_lag(tour.rows[0])
    assert tour.lag == MIN_LAG_S == lag_of(tour.rows[0], 0.0)


def went(
    lag: float, thresholds: Thresholds, delay: float = Drive().delay
) -> tuple[set[Cause], float]:
    """Why an arm with such drives stopped, and s of lag that it measured."""
    settings = RigSettings(drive=Drive(delay, lag), point_noise=0.1)
    rig = Rig(1, settings, pictures=False)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    rig.move_to_target()
    target = teach(plant, frames=30)
    rig.move_to_start()
    servo = Servo(settings.mechanism, settings.tool, thresholds=thresholds)
    states = [tick.state for tick in run(plant, servo, target, 4.0)]
    return {s.cause for s in states if s.cause.stopping}, states[-1].learnt.tour.lag


@pytest.mark.parametrize("lag", [0.005, 0.02, 0.06])
def test_an_arm_that_lags_goes_there_without_a_word_as_its_lag_is_measured(lag: float) -> None:
    causes, measured = went(lag, Thresholds())
    assert not causes
    assert measured == pytest.approx(lag + Drive().delay, rel=0.1)


def test_a_slower_one_needs_its_lag_told_and_a_wrong_one_stops_it() -> None:
    assert went(0.12, Thresholds())[0] == {Cause.NOT_FOLLOWING}
    assert not went(0.12, Thresholds(drive_lag=0.12))[0]
    assert went(0.06, Thresholds(drive_lag=0.01))[0] == {Cause.NOT_FOLLOWING}
    assert MAX_LAG_S > 0.12


@pytest.mark.parametrize("delay", [0.02, 0.04])
def test_an_arm_that_obeys_late_swings_about_no_corner_of_its_exploration(delay: float) -> None:
    """Unless the joints brake as long before it, they pass it one by one, and never meet there."""
    lag = 0.02
    for known in (0.0, lag + delay):
        causes, measured = went(lag, Thresholds(drive_lag=known), delay)
        assert not causes
        assert measured == pytest.approx(lag + delay, rel=0.25)
