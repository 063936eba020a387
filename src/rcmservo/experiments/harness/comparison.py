"""Comparing methods: their names, the laboratory in which all of them are tried, and who judges a
run.

Whether a run has settled is judged on the true features without noise, about the true imaged RCM:
single frames with 0.3 px of noise leave a tolerance of 0.5° by chance, and pose-based control has
no features of its own.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo.experiments.harness.claims import median, rms
from rcmservo.experiments.harness.closed_loop import FLOW, LONG
from rcmservo.guard.states import Cause
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import Plant
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.features import about, difference, features
from rcmservo.record.verdict import LAST, SAME_POSE, TOLERANCE
from rcmservo.servo.servo import State
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.tracking import PointMarkers

EVERY = 10
"""Ticks between two looks at the truth."""

AT_END = 5.0
"""s at the end of a run over which its pose error is taken: noise makes the tool wander for a
second at a time."""


@dataclass(frozen=True)
class Method:
    """``name`` in sentences, ``short`` in figures, ``where`` in the paper."""

    name: str
    short: str
    where: str


@dataclass(frozen=True)
class Learner(Method):
    """A method that needs no calibration: it explores and estimates Ĵ."""

    estimator: Estimator
    exploration: Exploration


OURS = Learner(
    "our projection-based default", "ours", "(21), fast Γ", ProjectionEstimator(), Exploration()
)
FLOW_RULE = Learner("the paper's flow rule (28) with γ = 0.001", "flow rule", "(28)", FLOW, LONG)


def laboratory(seed: int, scene: SceneSettings, noise: float) -> tuple[Rig, Plant]:
    """A scene, and its plant with the camera that delivers points with `noise` px."""
    rig = Rig(seed, RigSettings(point_noise=noise, scene=scene), pictures=False)
    return rig, Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)


class Watch:
    """The truth of a run to the scene's target, looked at EVERY ticks."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._y_d, self._p_d = (
            self._features(rig.scene.target),
            rig.body.points(rig.scene.target)[1],
        )
        self._times: list[float] = []
        self._good: list[bool] = []
        self._poses: list[float] = []
        self._jacobians: list[float] = []
        self._cause = Cause.NONE
        self.explored_at: float | None = None

    def _features(self, q: Floats) -> Floats:
        return features(about(self._rig.truth.pixels(q), self._rig.truth.imaged_rcm()))

    def look(
        self, k: int, time: float, state: State | None = None, q_exposure: Floats | None = None
    ) -> None:
        """Take note of tick k at `time` s; pose-based control has no servo `state`."""
        if state is not None:
            self._cause = state.cause
            if state.explored and self.explored_at is None:
                self.explored_at = time
        if k % EVERY:
            return
        q = self._rig.arm.q_true
        self._times.append(time)
        self._good.append(
            bool(np.all(np.abs(difference(self._features(q), self._y_d)) < TOLERANCE))
        )
        self._poses.append(float(np.linalg.norm(self._rig.body.points(q)[1] - self._p_d)))
        if state is not None and state.explored and q_exposure is not None:
            self._jacobians.append(
                self._rig.truth.jacobian_error(state.J_hat, q_exposure, state.o_c)
            )

    def verdict(self) -> dict[str, Any]:
        """Plain numbers: ``settle_time`` s and ``explored_at`` s from the first tick or None,
        ``pose`` mm the root mean square of ‖p₂ − p_d‖ over AT_END s, ``jacobian`` the median error
        of Ĵ after the exploration.

        A run that was ended early by a cause stays where it ended.
        """
        last = np.array(self._times) > self._times[-1] - AT_END
        settle_time = self._settle_time()
        pose = rms(np.array(self._poses)[last]) if self._cause is Cause.NONE else self._poses[-1]
        why_not = self._why_not(settle_time, pose)
        return {
            "why_not": why_not,
            "settle_time": None if why_not else settle_time,
            "explored_at": self.explored_at,
            "pose": pose,
            "jacobian": median(self._jacobians) if self._jacobians else None,
            "step": self._times[1],
            "poses": [round(pose, 5) for pose in self._poses],
        }

    def _settle_time(self) -> float | None:
        """When the true features last came within the tolerance, to stay for a second or more; None
        if they did not."""
        good = self._good
        since = len(good) - good[::-1].index(False) if False in good else 0
        stayed = since < len(good) and self._times[-1] - self._times[since] >= LAST - 1e-6
        return self._times[since] if stayed else None

    def _why_not(self, settle_time: float | None, pose: float) -> str:
        if self._cause is not Cause.NONE:
            return self._cause.value
        if settle_time is None:
            return "time ran out before the true features had settled"
        return "the features agree in another pose" if pose > SAME_POSE else ""
