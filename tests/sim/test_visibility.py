"""Oracle of visible disturbances, and the unnoticed growth of the error after them."""

from types import SimpleNamespace

import numpy as np
import pytest

from conftest import mark_others_slow, teach_target
from rcmservo.interfaces import Command
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo
from rcmservo.sim import Disturbance, Rig, RigSettings
from rcmservo.sim.disturbances.oracle import (
    INNOVATION_THRESHOLD,
    MIN_DURATION_NS,
    Oracle,
    UnnoticedGrowth,
)
from rcmservo.tracking import PointMarkers

NOISE = 0.3


def when_visible(text: str, seconds: float = 2.0, moving: bool = True, seed: int = 1) -> float:
    """Return the time (s) from the start to the oracle's detection, NaN if there is none."""
    disturbances = [Disturbance.parse(text)]
    rig = Rig(seed, RigSettings(point_noise=NOISE), False, disturbances)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    oracle = Oracle(rig.truth, NOISE)
    rig.begin()
    rig.arm.enable()
    began, rates = rig.clock.now(), moving * np.array([0.1, -0.1, 10.0])
    for k in range(round(seconds * 100)):
        rig.clock.wait_until(began + (k + 1) * 10_000_000)
        observation = plant.read()
        oracle.update(observation)
        deadline = observation.now + 50_000_000
        plant.send(Command(k, observation.now, deadline, rates, True))
    return np.nan if oracle.visible_since is None else (oracle.visible_since - began) * 1e-9


@pytest.mark.parametrize("seed", mark_others_slow(range(1, 4)))
def test_a_pan_is_visible_after_it_exceeds_the_noise_for_long_enough(seed: int) -> None:
    delay = INNOVATION_THRESHOLD * NOISE / 10.0  # s at 10 px/s, along u or v
    visible = when_visible("camera_pan:at=0.5,for=4.5,px=45", seed=seed)
    earliest = 0.5 + MIN_DURATION_NS * 1e-9
    assert earliest + 0.3 * delay < visible < earliest + 2.5 * delay + 0.1


@pytest.mark.parametrize(
    "text", ["freeze:at=0.5", "freeze:at=0.5,marker=2", "camera_clock:at=0.5,of=exposures"]
)
def test_faults_of_moving_frames_are_visible_only_while_the_tool_moves(
    text: str,
) -> None:
    assert 0.5 + MIN_DURATION_NS * 1e-9 < when_visible(text) < 1.5
    assert np.isnan(when_visible(text, moving=False))


def test_a_decoy_in_every_second_frame_is_never_visible() -> None:
    assert np.isnan(when_visible("decoy:at=0.2,every=2,px=100"))


def test_after_a_restart_the_oracle_uses_the_present_camera() -> None:
    zoomed = Disturbance("camera_zoom", parameters={"share": 0.1})
    rig = Rig(1, RigSettings(point_noise=NOISE), False, [zoomed])
    plant, oracle = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock), Oracle(rig.truth, NOISE)
    rig.begin()
    plant.read()
    rig.advance_until(rig.clock.now() + 60_000_000)
    observation = plant.read()
    before = np.abs(oracle.innovation(observation)).max()
    oracle.restart()
    assert before > INNOVATION_THRESHOLD > np.abs(oracle.innovation(observation)).max()


@pytest.mark.slow
def test_nothing_is_visible_in_20_runs_without_disturbances() -> None:
    innovations = []
    for seed in range(20):
        rig = Rig(seed, RigSettings(point_noise=NOISE), pictures=False)
        plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
        target = teach_target(rig, plant)
        servo = Servo(rig.settings.mechanism, rig.settings.tool)
        oracle = Oracle(rig.truth, NOISE)
        for tick in servo_ticks(plant, servo, target, 3.0):
            oracle.update(tick.observation)
            if tick.observation.frame >= 0:
                innovations.append(oracle.innovation(tick.observation))
        assert oracle.visible_since is None
    assert np.std(innovations) == pytest.approx(1.0, rel=0.05)


class StubOracle:
    """Oracle that detects a disturbance at the k-th update."""

    def __init__(self, k: int) -> None:
        self.remaining, self.visible_since = k, None

    def update(self, observation: object) -> None:
        self.remaining -= 1
        self.visible_since = 1 if self.remaining < 0 else None

    def reset(self) -> None:
        self.remaining, self.visible_since = 0, None


def ticks(*phases: Phase, cause: Cause = Cause.NONE) -> list[SimpleNamespace]:
    return [
        SimpleNamespace(observation=None, state=SimpleNamespace(phase=phase, cause=cause))
        for phase in phases
    ]


def unnoticed_growth(ticks: list[SimpleNamespace], errors: list[float], k: int = 2) -> float:
    unnoticed = UnnoticedGrowth(StubOracle(k))
    for tick, error in zip(ticks, errors, strict=True):
        unnoticed.update(tick, error)
    return unnoticed.growth


def test_growth_counts_from_the_moment_of_visibility() -> None:
    assert unnoticed_growth(ticks(*[Phase.SERVO] * 5), [1.0, 9.0, 2.0, 3.0, 5.5]) == pytest.approx(
        3.5
    )
    assert unnoticed_growth(ticks(*[Phase.SERVO] * 5), [1.0, 9.0, 7.0, 6.0, 5.5]) == 0.0
    assert unnoticed_growth(ticks(*[Phase.SERVO] * 5), [1.0, 2.0, 3.0, 4.0, 5.0], 9) == 0.0


def test_a_stop_or_a_reported_cause_ends_the_unnoticed_growth() -> None:
    stopped = [Phase.SERVO, Phase.SERVO, Phase.HOLD, Phase.PAUSED]
    assert unnoticed_growth(ticks(*stopped), [1.0, 2.0, 9.0, 9.0], 0) == pytest.approx(1.0)
    named = ticks(Phase.SERVO, Phase.SERVO, cause=Cause.REJECTED)
    assert unnoticed_growth(named, [1.0, 9.0], 0) == 0.0


def test_after_a_stop_the_growth_restarts() -> None:
    phases = [Phase.SERVO, Phase.HOLD, Phase.ACQUIRE, Phase.SERVO]
    assert unnoticed_growth(ticks(*phases), [1.0, 5.0, 5.0, 6.5], 0) == pytest.approx(1.5)
