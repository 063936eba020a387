"""Public names of rcmservo, available as `rs.NAME` after `import rcmservo as rs`."""

from rcmservo.config import class_registry
from rcmservo.config.class_registry import *  # noqa: F403
from rcmservo.control.exploration import Exploration
from rcmservo.control.feature_vectors import FeatureVector, MarkerPair, add_feature_vector
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import BadInput, RcmServoError, UnusableFile
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.geometry.features import (
    compute_features,
    compute_features_jacobian,
    shift_to_rcm,
)
from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.geometry.kinematics import JointLimits
from rcmservo.interfaces import (
    Arm,
    ArmMeasurement,
    Camera,
    Clock,
    Command,
    Frame,
    Markers,
    Observation,
    Target,
    Tracker,
)
from rcmservo.loop.clock import WallClock, ticks
from rcmservo.loop.operator import Jog, Operator, Teach
from rcmservo.loop.plant import Plant
from rcmservo.loop.run_result import DriveResponse, FinalPose, RunResult
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import Settled
from rcmservo.rig.result import RecordedResult
from rcmservo.rig.rig import Rig
from rcmservo.rig.run import run
from rcmservo.rig_loading import load_rig
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.gate import Gate
from rcmservo.safety.state_machine import Mode, Phase, Request
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.servo import Servo, State

__all__ = [
    "Action",
    "Arm",
    "ArmMeasurement",
    "BadInput",
    "Camera",
    "Cause",
    "Clock",
    "Command",
    "DriveResponse",
    "Estimator",
    "Exploration",
    "FeatureVector",
    "FinalPose",
    "Frame",
    "Gate",
    "ImagedRcm",
    "Jog",
    "JointLimits",
    "MarkerPair",
    "Markers",
    "Mode",
    "Observation",
    "Operator",
    "Phase",
    "Plant",
    "RcmServoError",
    "RecordedResult",
    "Request",
    "Rig",
    "RunResult",
    "Sample",
    "SaturatedController",
    "Servo",
    "Settled",
    "State",
    "Target",
    "Teach",
    "Thresholds",
    "Tick",
    "Tracker",
    "UnusableFile",
    "WallClock",
    "add_feature_vector",
    "compute_features",
    "compute_features_jacobian",
    "load_rig",
    "run",
    "servo_ticks",
    "shift_to_rcm",
    "teach",
    "ticks",
]
__all__ += class_registry.__all__
