"""Methods of the comparison: their inputs, and their closed loops.

Ten methods estimate Ĵ and need no calibration. One estimates a constant Jacobian of the four marker
coordinates from an exploration. The others receive a calibration, exact or wrong.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
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
from rcmservo.estimation.rls import RlsEstimator
from rcmservo.paper.lab.calibration import CalibratedEstimator, Quality
from rcmservo.paper.lab.constant_jacobian import ConstantJacobian
from rcmservo.paper.lab.paper_settings import (
    FAST_CONTROLLER,
    FAST_ESTIMATOR,
    FLOW_ESTIMATOR,
    FLOW_EXPLORATION,
    PROJECTION_EXPLORATION,
    SLOW_ESTIMATOR,
)
from rcmservo.paper.lab.scene_run import Attempt
from rcmservo.safety.thresholds import Thresholds
from rcmservo.study.run_outcome import StudyRun

LINES_ONLY = Exploration(tolerance=1e3)
"""The default exploration without its accuracy requirement: a calibrated method needs only o_c."""
CONSTANT_JACOBIAN_THRESHOLDS = Thresholds(max_contradictions=1000)
"""Thresholds that tolerate the prediction errors of a Jacobian that stays constant."""
POINTS_CONTROLLER = replace(FAST_CONTROLLER, features="points")
"""The common controller, on the four marker coordinates."""


ActsOn = Literal["features", "points", "poses"]
"""Error that a controller acts on: [s r d], the four marker coordinates, or the pose."""


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
    controller : SaturatedController
        Controller; by default the common one.
    """

    estimator: Estimator
    exploration: Exploration = field(default_factory=Exploration)
    controller: SaturatedController = field(default=FAST_CONTROLLER, kw_only=True)

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
    """A method with a calibration, image-based [12] or pose-based [20].

    Parameters
    ----------
    acts_on : ActsOn
        Error that the controller acts on.
    quality : Quality
        Quality of the calibration: exact, wrong, or outdated by a roll of the camera.
    """

    acts_on: ActsOn
    quality: Quality

    def run(self, attempt: Attempt) -> StudyRun:
        calibration = attempt.calibration(self.quality)
        if self.acts_on == "poses":
            return attempt.run_by_poses(calibration)
        controller = POINTS_CONTROLLER if self.acts_on == "points" else FAST_CONTROLLER
        return attempt.run(attempt.servo(CalibratedEstimator(calibration), LINES_ONLY, controller))


@dataclass(frozen=True)
class ConstantJacobianMethod(Method):
    """Control of four marker coordinates, with one constant Jacobian from the exploration."""

    def run(self, attempt: Attempt) -> StudyRun:
        servo = attempt.servo(ConstantJacobian(), LINES_ONLY, POINTS_CONTROLLER)
        return attempt.run(replace(servo, thresholds=CONSTANT_JACOBIAN_THRESHOLDS))


FAST = EstimatingMethod("the projection-based method with fast Γ (k = 2)", "fast Γ", FAST_ESTIMATOR)
DEFAULT = EstimatingMethod(
    "the default of rcmservo (whole projection, k = 8), by the image alone",
    "default",
    DltEstimator(),
    controller=SaturatedController(joint_trust=0.0),
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
NORMALISED_FLOW = "the flow rule normalised by the speed"
CORRENTROPY = "Kalman filter on Ĵ with maximum correntropy"
ONE_JACOBIAN = "one constant 4x3 Jacobian of the marker coordinates, from the exploration"


def _calibrated_methods() -> Iterator[tuple[str, CalibratedMethod]]:
    """Yield the methods with a calibration, by key."""
    controllers: tuple[tuple[str, ActsOn, str], ...] = (
        ("image", "features", "the image-based law"),
        ("points", "points", "point-based control"),
        ("pose", "poses", "pose-based control"),
    )
    qualities: tuple[tuple[Quality, str], ...] = (("exact", "an"), ("wrong", "a"))
    rolled = "the image-based law with a calibration outdated by a roll of the camera"
    for key, acts_on, controller in controllers:
        for quality, article in qualities:
            name = f"{controller} with {article} {quality} calibration"
            short = f"{key}, {quality} C"
            yield f"{key}-{quality}", CalibratedMethod(name, short, acts_on, quality)
        if key == "image":
            yield "image-rolled", CalibratedMethod(rolled, "image, rolled", acts_on, "rolled")


COMPARED_METHODS: Mapping[str, Method] = {
    **RCMSERVO_METHODS,
    "printed": EstimatingMethod(PRINTED_RULE, "printed Γ", SLOW_ESTIMATOR, PROJECTION_EXPLORATION),
    "flow": FLOW_RULE,
    "broyden": EstimatingMethod(BROYDEN, "Broyden", BroydenEstimator()),
    "broyden-1mm": EstimatingMethod(BROYDEN_1_MM, "Broyden, 1 mm", BroydenEstimator(min_step=1.0)),
    "nflow": EstimatingMethod(NORMALISED_FLOW, "normalised flow", NormalisedFlowEstimator()),
    "rls": EstimatingMethod("recursive least squares with forgetting", "RLS", RlsEstimator()),
    "kalman": EstimatingMethod("Kalman filter on Ĵ", "Kalman", KalmanEstimator()),
    "correntropy": EstimatingMethod(CORRENTROPY, "correntropy", CorrentropyEstimator()),
    "constant": ConstantJacobianMethod(ONE_JACOBIAN, "constant 4x3"),
    **dict(_calibrated_methods()),
}
"""All methods by key, which names their folders, in the order of the figures."""
