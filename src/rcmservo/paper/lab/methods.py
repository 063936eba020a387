"""The methods that are compared: what each is handed, and how it takes the tool to a target.

Ten estimate Ĵ and need no calibration. One estimates a constant Jacobian of the four marker
coordinates from the same exploration. The others are handed a calibration, exact or wrong.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.broyden import BroydenEstimator
from rcmservo.estimation.correntropy import CorrentropyEstimator
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.kalman import KalmanEstimator
from rcmservo.estimation.normalised_flow import NormalisedFlowEstimator
from rcmservo.estimation.projection_rule import PRINTED
from rcmservo.estimation.rls import RlsEstimator
from rcmservo.paper.lab.attempt import Attempt
from rcmservo.paper.lab.calibration import Calibrated, Quality
from rcmservo.paper.lab.closed_loop import FAST_FIT, FAST_LAW, FLOW, LONG, WIDE
from rcmservo.paper.lab.constant import ConstantJacobian
from rcmservo.safety.thresholds import Thresholds
from rcmservo.study.run_outcome import StudyRun

LINES_ONLY = Exploration(tolerance=1e3)
"""The default exploration, of which a calibrated law needs only the lines for o_c."""
TRUSTING = Thresholds(disagreements=1000)
"""Thresholds for a Jacobian that stays as it was while the tool moves on."""
POINTS_LAW = replace(FAST_LAW, features="points")
"""The law of all methods, on the four marker coordinates."""


@dataclass(frozen=True)
class Method(ABC):
    """A way to take the tool to a target.

    Parameters
    ----------
    name : str
        Name in sentences.
    short : str
        Name in figures and tables.
    """

    name: str
    short: str

    @abstractmethod
    def run(self, attempt: Attempt) -> StudyRun:
        """Take the tool to the target."""


@dataclass(frozen=True)
class Learner(Method):
    """A method without a calibration: it explores and estimates Ĵ.

    Parameters
    ----------
    estimator : Estimator
        Source of Ĵ.
    exploration : Exploration
        First motion, as this estimator needs it.
    controller : SaturatedController or None
        Its own law; None for that of all methods.
    """

    estimator: Estimator
    exploration: Exploration = field(default_factory=Exploration)
    controller: SaturatedController | None = field(default=None, kw_only=True)

    def run(self, attempt: Attempt) -> StudyRun:
        return attempt.run(attempt.servo(self.estimator, self.exploration, self.controller))


@dataclass(frozen=True)
class Own(Learner):
    """A user's own estimator, with our default exploration.

    Parameters
    ----------
    source : str
        Hash of its file: another one makes other results.
    """

    source: str = ""


@dataclass(frozen=True)
class CalibratedMethod(Method):
    """A law with a calibration: the traditional image-based one [12] on [s r d] or on the four
    marker coordinates, or the pose-based one [20].

    Parameters
    ----------
    acts_on : Literal['features', 'points', 'poses']
        Error that the law acts on.
    quality : Quality
        Quality of the calibration: exact, wrong, or from before the camera was rolled.
    """

    acts_on: Literal["features", "points", "poses"]
    quality: Quality

    def run(self, attempt: Attempt) -> StudyRun:
        calibration = attempt.calibration(self.quality)
        if self.acts_on == "poses":
            return attempt.by_poses(calibration)
        law = POINTS_LAW if self.acts_on == "points" else FAST_LAW
        return attempt.run(attempt.servo(Calibrated(calibration), LINES_ONLY, law))


@dataclass(frozen=True)
class Constant(Method):
    """The law on four marker coordinates, with one constant Jacobian estimated while exploring."""

    def run(self, attempt: Attempt) -> StudyRun:
        servo = attempt.servo(ConstantJacobian(), LINES_ONLY, POINTS_LAW)
        return attempt.run(replace(servo, thresholds=TRUSTING))


FAST = Learner("our projection-based method (fast Γ, k = 2)", "fast Γ", FAST_FIT)
DEFAULT = Learner(
    "our default (the whole projection, k = 8)",
    "default",
    DltEstimator(),
    controller=SaturatedController(),
)
OUR_METHODS = {"fast": FAST, "default": DEFAULT}
"""The two methods of this software's own."""
FLOW_RULE = Learner("the paper's flow rule (28) with γ = 0.001", "flow rule", FLOW, LONG)
STEP_MM = BroydenEstimator().min_step
PRINTED_RULE = "the paper's projection rule (21) with 10⁴ s of its own time a fit"
BROYDEN = f"Broyden's update on displacements of {STEP_MM:g} mm (as built in)"
BROYDEN_1_MM = "Broyden's update on displacements of 1 mm"
CORRENTROPY = "Kalman's filter on Ĵ with maximum correntropy"
ONE_JACOBIAN = "one constant 4x3 Jacobian of the marker coordinates, learnt while exploring"
ROLLED = "the image-based law with a calibration from before the camera was rolled"

METHODS: Mapping[str, Method] = {
    **OUR_METHODS,
    "printed": Learner(PRINTED_RULE, "printed Γ", PRINTED, WIDE),
    "flow": FLOW_RULE,
    "broyden": Learner(BROYDEN, "Broyden", BroydenEstimator()),
    "broyden-1mm": Learner(BROYDEN_1_MM, "Broyden, 1 mm", BroydenEstimator(min_step=1.0)),
    "nflow": Learner(
        "the flow rule normalised by the speed", "normalised flow", NormalisedFlowEstimator()
    ),
    "rls": Learner("recursive least squares with forgetting", "RLS", RlsEstimator()),
    "kalman": Learner("Kalman's filter on Ĵ", "Kalman", KalmanEstimator()),
    "correntropy": Learner(CORRENTROPY, "correntropy", CorrentropyEstimator()),
    "constant": Constant(ONE_JACOBIAN, "constant 4x3"),
    "image-exact": CalibratedMethod(
        "the image-based law with an exact calibration", "image, exact C", "features", "exact"
    ),
    "image-wrong": CalibratedMethod(
        "the image-based law with a wrong calibration", "image, wrong C", "features", "wrong"
    ),
    "image-rolled": CalibratedMethod(ROLLED, "image, rolled", "features", "rolled"),
    "points-exact": CalibratedMethod(
        "point-based control with an exact calibration", "points, exact C", "points", "exact"
    ),
    "points-wrong": CalibratedMethod(
        "point-based control with a wrong calibration", "points, wrong C", "points", "wrong"
    ),
    "pose-exact": CalibratedMethod(
        "pose-based control with an exact calibration", "pose, exact C", "poses", "exact"
    ),
    "pose-wrong": CalibratedMethod(
        "pose-based control with a wrong calibration", "pose, wrong C", "poses", "wrong"
    ),
}
"""Every method by its name in folders, in the order of the figures."""
