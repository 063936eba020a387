"""The public names of rcmservo: what `import rcmservo as rs` offers."""

from rcmservo.errors import BadInput, RcmServoError, UnusableFile
from rcmservo.guard.causes import Action, Cause
from rcmservo.guard.gate import Gate
from rcmservo.guard.states import Mode, Phase, Request
from rcmservo.guard.thresholds import Thresholds
from rcmservo.interfaces import (
    Arm,
    Camera,
    Clock,
    Command,
    Frame,
    Markers,
    Measured,
    Observation,
    Target,
    Tracker,
)
from rcmservo.loop.clock import WallClock, ticks
from rcmservo.loop.operator import Jog, Operator, Teach
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import run
from rcmservo.loop.teach import teach
from rcmservo.loop.tick import Tick
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.affine import AffineEstimator
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.correntropy import CorrentropyEstimator
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.flow import FlowEstimator
from rcmservo.method.estimators.kalman import KalmanEstimator
from rcmservo.method.estimators.nflow import NormalisedFlowEstimator
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.estimators.rls import RlsEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.feature_vectors import FeatureVector, MarkerPair, add_feature_vector
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.method.kinematics import JointLimits, PitchYawRcm, SphericalRcm
from rcmservo.method.tool import RigidTool, ScaledTool
from rcmservo.servo.servo import Servo, State

__all__ = [
    "Action",
    "AffineEstimator",
    "Arm",
    "BadInput",
    "BroydenEstimator",
    "Camera",
    "Cause",
    "Clock",
    "Command",
    "CorrentropyEstimator",
    "DltEstimator",
    "Estimator",
    "Exploration",
    "FeatureVector",
    "FlowEstimator",
    "Frame",
    "Gate",
    "ImagedRcm",
    "Jog",
    "JointLimits",
    "KalmanEstimator",
    "MarkerPair",
    "Markers",
    "Measured",
    "Mode",
    "NormalisedFlowEstimator",
    "Observation",
    "Operator",
    "Phase",
    "PitchYawRcm",
    "Plant",
    "ProjectionEstimator",
    "RcmServoError",
    "Request",
    "RigidTool",
    "RlsEstimator",
    "Sample",
    "SaturatedController",
    "ScaledTool",
    "Servo",
    "SphericalRcm",
    "State",
    "Target",
    "Teach",
    "Thresholds",
    "Tick",
    "Tracker",
    "UnusableFile",
    "WallClock",
    "add_feature_vector",
    "run",
    "teach",
    "ticks",
]
