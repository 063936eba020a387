"""What the truth says of a servo's run to the scene's target.

Whether a run has settled is judged on the true features without noise, about the true imaged RCM:
single frames with noise leave the tolerance by chance.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.experiments.harness.lab.closed_loop import FAST_FIT, FAST_LAW, SHOWN
from rcmservo.experiments.harness.statistics import median, rms
from rcmservo.guard.causes import Cause
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.features import about, difference, features
from rcmservo.method.tool import Tool
from rcmservo.record.verdict import SAME_POSE, settle_time
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.tracking import PointMarkers

EVERY = 10
"""Ticks between two looks at the truth."""

AT_END = 5.0
"""s at the end of a run over which its pose error is taken: noise makes the tool wander for a
second at a time."""


@dataclass(frozen=True)
class Trial:
    """What the truth says of one run."""

    seed: int
    """Of the scene."""
    why_not: str
    """Why it did not settle; empty if it did."""
    settle_time: float | None
    """s from the first tick on, or None."""
    pose: float
    """‖p₂ − p_d‖ mm, rms over AT_END s; of a run that a cause ended, where it ended."""
    jacobian: float | None
    """Median scaled error of Ĵ after the exploration; None if that did not end."""

    @property
    def settled(self) -> bool:
        return not self.why_not


def laboratory(seed: int, scene: SceneSettings, noise: float) -> tuple[Rig, Plant]:
    """A scene, and its plant with the camera that delivers points with `noise` px."""
    return seen_by_points(seed, RigSettings(point_noise=noise, scene=scene))


def seen_by_points(seed: int, settings: RigSettings) -> tuple[Rig, Plant]:
    """A rig, and its plant with the camera that delivers points."""
    rig = Rig(seed, settings, pictures=False)
    return rig, Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)


class Witness:
    """Looks at the truth every EVERY ticks of a run to the scene's target."""

    def __init__(self, rig: Rig) -> None:
        target = rig.scene.target
        self._rig, self._p_d = rig, rig.body.points(target)[1]
        self._y_d = self._features(target)
        self._ticks = 0
        self._times: list[float] = []
        self._deltas: list[Floats] = []
        self._poses: list[float] = []
        self._jacobians: list[float] = []
        self._cause = Cause.NONE

    def _features(self, q: Floats) -> Floats:
        return features(about(self._rig.truth.pixels(q), self._rig.truth.imaged_rcm()))

    def look_at(self, tick: Tick) -> None:
        """Take note of a tick."""
        state, self._cause = tick.state, tick.state.cause
        self._ticks += 1
        if (self._ticks - 1) % EVERY:
            return
        q = self._rig.arm.q_true
        self._times.append(tick.time / 1e9)
        self._deltas.append(difference(self._features(q), self._y_d))
        away: Floats = self._rig.body.points(q)[1] - self._p_d
        self._poses.append(float(np.linalg.norm(away)))
        if state.explored:
            error = self._rig.truth.jacobian_error(state.J_hat, tick.seen.q_exposure, state.o_c)
            self._jacobians.append(error)

    def trial(self) -> Trial:
        """What became of the run."""
        times, pose = np.array(self._times), self._pose()
        settled_at = settle_time(times, np.array(self._deltas))
        why_not = self._why_not(settled_at, pose)
        return Trial(
            seed=self._rig.seed,
            why_not=why_not,
            settle_time=None if why_not else settled_at,
            pose=pose,
            jacobian=median(self._jacobians) if self._jacobians else None,
        )

    def _pose(self) -> float:
        if self._cause.stopping:
            return self._poses[-1]
        times = np.array(self._times)
        return rms(np.array(self._poses)[times > times[-1] - AT_END])

    def _why_not(self, settled_at: float | None, pose: float) -> str:
        if self._cause.stopping:
            return self._cause.stopping
        if settled_at is None:
            return "time ran out before the true features had settled"
        return "the features agree in another pose" if pose > SAME_POSE else ""


def settle(
    seed: int, settings: RigSettings, duration: float, known: Tool | None = None
) -> tuple[Trial, list[Tick]]:
    """Servo from home to the scene's target with the fast fit and law: the trial and its ticks. The
    servo takes its tool as `known`, if not as it is."""
    rig, plant = seen_by_points(seed, settings)
    rig.show_target()
    target = teach(plant, SHOWN)
    rig.go_home()
    servo = Servo(settings.mechanism, known or settings.tool, FAST_FIT, FAST_LAW)
    witness, ticks = Witness(rig), list[Tick]()
    for tick in run(plant, servo, target, duration):
        witness.look_at(tick)
        ticks.append(tick)
    return witness.trial(), ticks


def why_not(trials: list[Trial]) -> str:
    """Why some did not settle, as the end of a sentence."""
    causes = sorted({trial.why_not for trial in trials if not trial.settled})
    return "; not settled: " + ", ".join(causes) if causes else ""
