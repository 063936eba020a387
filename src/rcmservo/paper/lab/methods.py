"""Methods of the comparison: their inputs, and their closed loops.

Ten methods estimate Ĵ and need no calibration. One estimates a constant Jacobian of the four marker
coordinates from an exploration. The others receive a calibration, exact or wrong.
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
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR
from rcmservo.estimation.rls import RlsEstimator
from rcmservo.paper.lab.calibration import CalibratedEstimator, Quality
from rcmservo.paper.lab.closed_loop import (
    FAST_FIT,
    FAST_LAW,
    FLOW_ESTIMATOR,
    FLOW_EXPLORATION,
    PROJECTION_EXPLORATION,
)
from rcmservo.paper.lab.constant_jacobian import ConstantJacobian
from rcmservo.paper.lab.scene_run import Attempt
from rcmservo.safety.thresholds import Thresholds
from rcmservo.study.run_outcome import StudyRun

LINES_ONLY = Exploration(tolerance=1e3)
"""The default exploration without its accuracy requirement: a calibrated law needs only o_c."""
CONSTANT_JACOBIAN_THRESHOLDS = Thresholds(max_contradictions=1000)
"""Thresholds that tolerate the prediction errors of a Jacobian that stays constant."""
POINTS_LAW = replace(FAST_LAW, features="points")
"""The common law, on the four marker coordinates."""


@dataclass(frozen=True)
class Method(ABC):
    """A method to move the tool to a target.

    Parameters
    ----------
    name : str
        Name in sentences.
    short : str
        Short name in figures and tables.
    """

    name: str
    short: str

    @abstractmethod
    def run(self, attempt: Attempt) -> StudyRun:
        """Run the method in the scene of `attempt`."""


@dataclass(frozen=True)
class EstimatingMethod(Method):
    """A method without a calibration: it explores and estimates Ĵ.

    Parameters
    ----------
    estimator : Estimator
        Estimator of Ĵ.
    exploration : Exploration
        Exploration that the estimator requires.
    controller : SaturatedController or None
        Control law; None for the common one.
    """

    estimator: Estimator
    exploration: Exploration = field(default_factory=Exploration)
    controller: SaturatedController | None = field(default=None, kw_only=True)

    def run(self, attempt: Attempt) -> StudyRun:
        return attempt.run(attempt.servo(self.estimator, self.exploration, self.controller))


@dataclass(frozen=True)
class UserEstimatorMethod(EstimatingMethod):
    """A user-defined estimator, with the default exploration.

    Parameters
    ----------
    source : str
        Hash of the source file; a different source invalidates stored results.
    """

    source: str = ""


@dataclass(frozen=True)
class CalibratedMethod(Method):
    """A law with a calibration, image-based [12] or pose-based [20].

    Parameters
    ----------
    acts_on : Literal['features', 'points', 'poses']
        Error that the law acts on: [s r d], the four marker coordinates, or the pose.
    quality : Quality
        Quality of the calibration: exact, wrong, or outdated by a roll of the camera.
    """

    acts_on: Literal["features", "points", "poses"]
    quality: Quality

    def run(self, attempt: Attempt) -> StudyRun:
        calibration = attempt.calibration(self.quality)
        if self.acts_on == "poses":
            return attempt.by_poses(calibration)
        law = POINTS_LAW if self.acts_on == "points" else FAST_LAW
        return attempt.run(attempt.servo(CalibratedEstimator(calibration), LINES_ONLY, law))


@dataclass(frozen=True)
class ConstantJacobianMethod(Method):
    """Law on four marker coordinates, with one constant Jacobian from the exploration."""

    def run(self, attempt: Attempt) -> StudyRun:
        servo = attempt.servo(ConstantJacobian(), LINES_ONLY, POINTS_LAW)
        return attempt.run(replace(servo, thresholds=CONSTANT_JACOBIAN_THRESHOLDS))


FAST = EstimatingMethod("the projection-based method with fast Γ (k = 2)", "fast Γ", FAST_FIT)
DEFAULT = EstimatingMethod(
    "the default of rcmservo (whole projection, k = 8)",
    "default",
    DltEstimator(),
    controller=SaturatedController(),
)
RCMSERVO_METHODS = {"fast": FAST, "default": DEFAULT}
"""The two methods of rcmservo that the claims concern."""
FLOW_RULE = EstimatingMethod(
    "the paper's flow rule (28) with γ = 0.001", "flow rule", FLOW_ESTIMATOR, FLOW_EXPLORATION
)
BROYDEN_STEP_MM = BroydenEstimator().min_step
PRINTED_RULE = "the paper's projection rule (21) with 10⁴ s of estimator time per fit"
BROYDEN = f"Broyden's update on displacements of {BROYDEN_STEP_MM:g} mm (default)"
BROYDEN_1_MM = "Broyden's update on displacements of 1 mm"
CORRENTROPY = "Kalman filter on Ĵ with maximum correntropy"
ONE_JACOBIAN = "one constant 4x3 Jacobian of the marker coordinates, from the exploration"
ROLLED = "the image-based law with a calibration outdated by a roll of the camera"

COMPARED_METHODS: Mapping[str, Method] = {
    **RCMSERVO_METHODS,
    "printed": EstimatingMethod(
        PRINTED_RULE, "printed Γ", PAPER_PROJECTION_ESTIMATOR, PROJECTION_EXPLORATION
    ),
    "flow": FLOW_RULE,
    "broyden": EstimatingMethod(BROYDEN, "Broyden", BroydenEstimator()),
    "broyden-1mm": EstimatingMethod(BROYDEN_1_MM, "Broyden, 1 mm", BroydenEstimator(min_step=1.0)),
    "nflow": EstimatingMethod(
        "the flow rule normalised by the speed", "normalised flow", NormalisedFlowEstimator()
    ),
    "rls": EstimatingMethod("recursive least squares with forgetting", "RLS", RlsEstimator()),
    "kalman": EstimatingMethod("Kalman filter on Ĵ", "Kalman", KalmanEstimator()),
    "correntropy": EstimatingMethod(CORRENTROPY, "correntropy", CorrentropyEstimator()),
    "constant": ConstantJacobianMethod(ONE_JACOBIAN, "constant 4x3"),
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
"""All methods by key, which names their folders, in the order of the figures."""
