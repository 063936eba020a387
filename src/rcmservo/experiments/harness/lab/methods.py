"""The methods that are compared: what each is handed, and how it takes the tool to a target.

Ten learn Ĵ and need no calibration. One learns a constant Jacobian of the four marker coordinates
from the same exploration. The others are handed a calibration, exact or wrong.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from rcmservo.experiments.harness.lab.closed_loop import (
    FAST_FIT,
    FAST_LAW,
    FLOW,
    LONG,
    PRINTED_FIT,
    WIDE,
    servo_for,
)
from rcmservo.experiments.harness.lab.others.calibration import (
    Calibrated,
    Calibration,
    Miscalibration,
    exact,
    rolled,
    wrong,
)
from rcmservo.experiments.harness.lab.others.constant import ConstantJacobian
from rcmservo.experiments.harness.lab.others.laws import PoseLaw, drive
from rcmservo.experiments.harness.lab.witness import Trial, Witness, laboratory
from rcmservo.guard.thresholds import Thresholds
from rcmservo.interfaces import Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.correntropy import CorrentropyEstimator
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.kalman import KalmanEstimator
from rcmservo.method.estimators.nflow import NormalisedFlowEstimator
from rcmservo.method.estimators.rls import RlsEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, SceneSettings

LINES_ONLY = Exploration(tolerance=1e3)
"""The default tour, of which a calibrated law needs nothing but the lines for o_c: it trusts its
Ĵ."""

TRUSTING = Thresholds(disagreements=1000)
"""Of a Jacobian that stays as it was while the tool goes on."""

Quality = Literal["exact", "wrong", "rolled"]


@dataclass(frozen=True)
class Conditions:
    """What is the same for every method."""

    noise: float = 0.3
    """px, of every marker coordinate."""
    duration: float = 20.0
    """s after the exploration."""
    controller: SaturatedController = FAST_LAW
    """Of every servo but our default's; laws that are not a servo's take its gain k and its
    greatest speed."""
    miscalibration: Miscalibration = field(default_factory=Miscalibration)
    """How wrong a wrong calibration is."""
    roll: float = float(np.radians(90.0))
    """rad by which the camera was rolled after it had been calibrated."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """One method in one scene."""

    rig: Rig
    """The laboratory with the scene."""
    plant: Plant
    """What the method sees and moves."""
    target: Target
    """What the camera saw when the scene's target was shown."""
    witness: Witness
    """It judges the run by the truth."""
    conditions: Conditions
    """The same for every method."""

    def calibration(self, quality: Quality) -> Calibration:
        """What a person hands over: exact, wrong in directions drawn from the seed, or stale."""
        optics, conditions = self.rig.scene.optics, self.conditions
        if quality == "exact":
            return exact(optics)
        if quality == "rolled":
            return rolled(optics, conditions.roll)
        random = np.random.default_rng([self.rig.seed, 1])
        return wrong(optics, conditions.miscalibration, random)

    def servo(
        self,
        estimator: Estimator,
        exploration: Exploration,
        controller: SaturatedController | None = None,
    ) -> Servo:
        """A servo, if not with a controller of its own with that of all methods."""
        law = controller or self.conditions.controller
        return servo_for(self.rig, estimator, exploration, law)

    def servo_by(self, servo: Servo) -> None:
        """Explore, then servo for as long as every method has."""
        witness, duration = self.witness, self.conditions.duration

        def over(tick: Tick) -> bool:
            explored = witness.explored_at
            return explored is not None and tick.time / 1e9 >= explored + duration

        longest = servo.exploration.max_time + duration
        for tick in run(self.plant, servo, self.target, longest, done=over):
            witness.look_at(tick)

    def move_by(self, law: PoseLaw) -> None:
        """Move by a law of its own."""
        robot = self.servo(FAST_FIT, Exploration())
        for time in drive(self.plant, robot, law, self.conditions.duration):
            self.witness.look(time)


@dataclass(frozen=True)
class Method(ABC):
    """A way to take the tool to a target."""

    name: str
    """In sentences."""
    short: str
    """In figures and tables."""

    @abstractmethod
    def run(self, attempt: Attempt) -> None:
        """Take the tool to the target, the witness looking on."""


@dataclass(frozen=True)
class Learner(Method):
    """Needs no calibration: it explores and estimates Ĵ."""

    estimator: Estimator
    """What Ĵ comes from."""
    exploration: Exploration
    """The first motion, as this estimator needs it."""
    controller: SaturatedController | None = field(default=None, kw_only=True)
    """Its own; None for that of all methods."""

    def run(self, attempt: Attempt) -> None:
        attempt.servo_by(attempt.servo(self.estimator, self.exploration, self.controller))


@dataclass(frozen=True)
class Own(Learner):
    """A user's own estimator, with our default exploration."""

    source: str
    """Hash of its file: another one makes other results."""


@dataclass(frozen=True)
class ImageBased(Method):
    """The traditional image-based law [12] on [s r d], with Ĵ from a calibration."""

    quality: Quality
    """Of the calibration: exact, wrong, or from before the camera was rolled."""

    def run(self, attempt: Attempt) -> None:
        estimator = Calibrated(attempt.calibration(self.quality))
        attempt.servo_by(attempt.servo(estimator, LINES_ONLY))


@dataclass(frozen=True)
class PoseBased(Method):
    """Pose-based control [20], with a calibration."""

    quality: Quality
    """Of the calibration."""

    def run(self, attempt: Attempt) -> None:
        robot = attempt.servo(FAST_FIT, Exploration())
        given, gain = attempt.calibration(self.quality), attempt.conditions.controller.gain
        attempt.move_by(PoseLaw(given, robot, attempt.target, gain))


@dataclass(frozen=True)
class PointBased(Method):
    """The law on four marker coordinates, with a calibration."""

    quality: Quality
    """Of the calibration: exact or wrong."""

    def run(self, attempt: Attempt) -> None:
        law = replace(attempt.conditions.controller, features="points")
        estimator = Calibrated(attempt.calibration(self.quality))
        attempt.servo_by(attempt.servo(estimator, LINES_ONLY, law))


@dataclass(frozen=True)
class Constant(Method):
    """The law on four marker coordinates, with one constant Jacobian learnt while exploring."""

    def run(self, attempt: Attempt) -> None:
        law = replace(attempt.conditions.controller, features="points")
        servo = attempt.servo(ConstantJacobian(), LINES_ONLY, law)
        attempt.servo_by(replace(servo, thresholds=TRUSTING))


FAST = Learner("our projection-based method (fast Γ, k = 2)", "fast Γ", FAST_FIT, Exploration())
DEFAULT = Learner(
    "our default (the whole projection, k = 8)",
    "default",
    DltEstimator(),
    Exploration(),
    controller=SaturatedController(),
)
OUR_METHODS = {"fast": FAST, "default": DEFAULT}
"""The two that are this software's own."""

FLOW_RULE = Learner("the paper's flow rule (28) with γ = 0.001", "flow rule", FLOW, LONG)
STEP = BroydenEstimator().min_step

METHODS: Mapping[str, Method] = {
    **OUR_METHODS,
    "printed": Learner(
        "the paper's projection rule (21) with 10⁴ s of its own time a fit",
        "printed Γ",
        PRINTED_FIT,
        WIDE,
    ),
    "flow": FLOW_RULE,
    "broyden": Learner(
        f"Broyden's update on displacements of {STEP:g} mm (as built in)",
        "Broyden",
        BroydenEstimator(),
        Exploration(),
    ),
    "broyden-1mm": Learner(
        "Broyden's update on displacements of 1 mm",
        "Broyden, 1 mm",
        BroydenEstimator(min_step=1.0),
        Exploration(),
    ),
    "nflow": Learner(
        "the flow rule normalised by the speed",
        "normalised flow",
        NormalisedFlowEstimator(),
        Exploration(),
    ),
    "rls": Learner("recursive least squares with forgetting", "RLS", RlsEstimator(), Exploration()),
    "kalman": Learner("Kalman's filter on Ĵ", "Kalman", KalmanEstimator(), Exploration()),
    "correntropy": Learner(
        "Kalman's filter on Ĵ with maximum correntropy",
        "correntropy",
        CorrentropyEstimator(),
        Exploration(),
    ),
    "constant": Constant(
        "one constant 4x3 Jacobian of the marker coordinates, learnt while exploring",
        "constant 4x3",
    ),
    "image-exact": ImageBased(
        "the image-based law with an exact calibration", "image, exact C", "exact"
    ),
    "image-wrong": ImageBased(
        "the image-based law with a wrong calibration", "image, wrong C", "wrong"
    ),
    "image-rolled": ImageBased(
        "the image-based law with a calibration from before the camera was rolled",
        "image, rolled",
        "rolled",
    ),
    "points-exact": PointBased(
        "point-based control with an exact calibration", "points, exact C", "exact"
    ),
    "points-wrong": PointBased(
        "point-based control with a wrong calibration", "points, wrong C", "wrong"
    ),
    "pose-exact": PoseBased(
        "pose-based control with an exact calibration", "pose, exact C", "exact"
    ),
    "pose-wrong": PoseBased(
        "pose-based control with a wrong calibration", "pose, wrong C", "wrong"
    ),
}
"""Every method by its name in folders, in the order of the figures."""


def attempted(method: Method, scene: SceneSettings, seed: int, conditions: Conditions) -> Trial:
    """One method in one scene, and what the truth says of it."""
    rig, plant = laboratory(seed, scene, conditions.noise)
    rig.show_target()
    target = teach(plant)
    rig.go_home()
    attempt = Attempt(rig, plant, target, Witness(rig), conditions)
    method.run(attempt)
    return attempt.witness.trial()
