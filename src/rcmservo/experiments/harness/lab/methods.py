"""The methods that are compared: what each is handed, and how it takes the tool to a target.

Five learn Ĵ and need no calibration. One learns a constant Jacobian of the four marker coordinates
from the same exploration. The others are handed a calibration, exact or wrong.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from rcmservo.experiments.harness.lab.calibration import (
    Calibrated,
    Calibration,
    Miscalibration,
    exact,
    rolled,
    wrong,
)
from rcmservo.experiments.harness.lab.closed_loop import FLOW, LONG, PRINTED_FIT, WIDE, servo_for
from rcmservo.experiments.harness.lab.laws import Law, PointLaw, PoseLaw, Seen, drive
from rcmservo.experiments.harness.lab.witness import Trial, Witness, laboratory
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, SceneSettings

LINES_ONLY = Exploration(tolerance=1e3)
"""The default tour, of which a calibrated law needs nothing but the lines for o_c: it trusts its
Ĵ."""

Quality = Literal["exact", "wrong", "rolled"]


@dataclass(frozen=True)
class Conditions:
    """What is the same for every method."""

    noise: float = 0.3
    """px, of every marker coordinate."""
    duration: float = 20.0
    """s after the exploration."""
    controller: SaturatedController = field(default_factory=SaturatedController)
    """Of every servo; laws that are not a servo's take its gain k and its greatest speed."""
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

    def servo(self, estimator: Estimator, exploration: Exploration) -> Servo:
        """A servo with the controller of all methods."""
        return servo_for(self.rig, estimator, exploration, self.conditions.controller)

    def servo_by(self, servo: Servo) -> None:
        """Explore, then servo for as long as every method has."""
        witness, duration = self.witness, self.conditions.duration

        def over(tick: Tick) -> bool:
            explored = witness.explored_at
            return explored is not None and tick.time / 1e9 >= explored + duration

        longest = servo.exploration.max_time + duration
        for tick in run(self.plant, servo, self.target, longest, done=over):
            witness.look_at(tick)

    def move_by(self, law: Law, after: float = 0.0) -> None:
        """Move by a law of its own, from `after` s on."""
        robot = self.servo(ProjectionEstimator(), Exploration())
        for time in drive(self.plant, robot, law, self.conditions.duration):
            self.witness.look(after + time)

    def explore(self) -> Seen:
        """Explore as our default does, and keep what was seen on the way."""
        servo = self.servo(ProjectionEstimator(), Exploration())
        frames: dict[int, tuple[Floats, Floats]] = {}
        longest = servo.exploration.max_time
        for tick in run(self.plant, servo, self.target, longest, done=_explored):
            self.witness.look_at(tick)
            if 0 <= tick.state.believed == tick.seen.frame:
                frames[tick.seen.frame] = (tick.state.p1, tick.seen.points.ravel())
        p1, m = zip(*frames.values(), strict=True)
        return Seen(np.array(p1), np.array(m))


def _explored(tick: Tick) -> bool:
    return tick.state.explored


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

    def run(self, attempt: Attempt) -> None:
        attempt.servo_by(attempt.servo(self.estimator, self.exploration))


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
        robot = attempt.servo(ProjectionEstimator(), Exploration())
        given, gain = attempt.calibration(self.quality), attempt.conditions.controller.gain
        attempt.move_by(PoseLaw(given, robot, attempt.target, gain))


@dataclass(frozen=True)
class PointBased(Method):
    """Point-based control on four marker coordinates, with a calibration and no exploration."""

    quality: Quality
    """Of the calibration."""

    def run(self, attempt: Attempt) -> None:
        given, tool = attempt.calibration(self.quality), attempt.rig.settings.tool

        def jacobian(p1: Floats) -> Floats:
            return given.points_jacobian(p1, tool)

        attempt.move_by(PointLaw(jacobian, attempt.target, attempt.conditions.controller.gain))


@dataclass(frozen=True)
class ConstantJacobian(Method):
    """One constant Jacobian (4, 3) of the marker coordinates, learnt while exploring."""

    def run(self, attempt: Attempt) -> None:
        began = attempt.rig.clock.now()
        L = attempt.explore().constant_jacobian()
        explored = (attempt.rig.clock.now() - began) / 1e9
        law = PointLaw(lambda _: L, attempt.target, attempt.conditions.controller.gain)
        attempt.move_by(law, after=explored)


DEFAULT = Learner("our projection-based default", "ours", ProjectionEstimator(), Exploration())
FLOW_RULE = Learner("the paper's flow rule (28) with γ = 0.001", "flow rule", FLOW, LONG)
STEP = BroydenEstimator().min_step

METHODS: Mapping[str, Method] = {
    "ours": DEFAULT,
    "printed": Learner(
        "the paper's projection rule (21) with 10⁴ s of its own time a fit",
        "printed Γ",
        PRINTED_FIT,
        WIDE,
    ),
    "flow": FLOW_RULE,
    "broyden": Learner(
        f"Broyden's update on displacements of {STEP:g} mm (our default)",
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
    "constant": ConstantJacobian(
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
