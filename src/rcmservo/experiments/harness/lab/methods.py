"""The methods that are compared: what each is handed, and how it takes the tool to a target.

Ten learn Ĵ and need no calibration. One learns a constant Jacobian of the four marker coordinates
from the same exploration. The others are handed a calibration, exact or wrong.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rcmservo.experiments.harness.lab.attempt import Attempt, Fared
from rcmservo.experiments.harness.lab.closed_loop import FAST_FIT, FLOW, LONG, PRINTED_FIT, WIDE
from rcmservo.experiments.harness.lab.others.calibration import Calibrated, Quality
from rcmservo.experiments.harness.lab.others.constant import ConstantJacobian
from rcmservo.guard.thresholds import Thresholds
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.correntropy import CorrentropyEstimator
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.kalman import KalmanEstimator
from rcmservo.method.estimators.nflow import NormalisedFlowEstimator
from rcmservo.method.estimators.rls import RlsEstimator
from rcmservo.method.exploration import Exploration

LINES_ONLY = Exploration(tolerance=1e3)
"""The default tour, of which a calibrated law needs nothing but the lines for o_c: it trusts its
Ĵ."""

TRUSTING = Thresholds(disagreements=1000)
"""Of a Jacobian that stays as it was while the tool goes on."""


@dataclass(frozen=True)
class Method(ABC):
    """A way to take the tool to a target."""

    name: str
    """In sentences."""
    short: str
    """In figures and tables."""

    @abstractmethod
    def run(self, attempt: Attempt) -> Fared:
        """Take the tool to the target."""


@dataclass(frozen=True)
class Learner(Method):
    """Needs no calibration: it explores and estimates Ĵ."""

    estimator: Estimator
    """What Ĵ comes from."""
    exploration: Exploration
    """The first motion, as this estimator needs it."""
    controller: SaturatedController | None = field(default=None, kw_only=True)
    """Its own; None for that of all methods."""

    def run(self, attempt: Attempt) -> Fared:
        return attempt.servo_by(attempt.servo(self.estimator, self.exploration, self.controller))


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

    def run(self, attempt: Attempt) -> Fared:
        estimator = Calibrated(attempt.calibration(self.quality))
        return attempt.servo_by(attempt.servo(estimator, LINES_ONLY))


@dataclass(frozen=True)
class PoseBased(Method):
    """Pose-based control [20], with a calibration."""

    quality: Quality
    """Of the calibration."""

    def run(self, attempt: Attempt) -> Fared:
        return attempt.by_poses(attempt.calibration(self.quality))


@dataclass(frozen=True)
class PointBased(Method):
    """The law on four marker coordinates, with a calibration."""

    quality: Quality
    """Of the calibration: exact or wrong."""

    def run(self, attempt: Attempt) -> Fared:
        law = replace(attempt.conditions.controller, features="points")
        estimator = Calibrated(attempt.calibration(self.quality))
        return attempt.servo_by(attempt.servo(estimator, LINES_ONLY, law))


@dataclass(frozen=True)
class Constant(Method):
    """The law on four marker coordinates, with one constant Jacobian learnt while exploring."""

    def run(self, attempt: Attempt) -> Fared:
        law = replace(attempt.conditions.controller, features="points")
        servo = attempt.servo(ConstantJacobian(), LINES_ONLY, law)
        return attempt.servo_by(replace(servo, thresholds=TRUSTING))


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
