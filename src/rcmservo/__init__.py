"""rcmservo: position the tool of a remote-centre-of-motion mechanism from one uncalibrated camera."""

import importlib
from types import ModuleType

from rcmservo.clock import ticks
from rcmservo.controller import SaturatedController
from rcmservo.errors import BadInput, RcmServoError, UnusableFile
from rcmservo.estimators.broyden import BroydenEstimator
from rcmservo.estimators.flow import FlowEstimator
from rcmservo.estimators.projection import ProjectionEstimator
from rcmservo.exploration import Exploration
from rcmservo.faults import Thresholds
from rcmservo.imaged_rcm import ImagedRcm
from rcmservo.loop import Plant, Tick, run, teach
from rcmservo.mechanism import JointLimits, PitchYawRcm, SphericalRcm
from rcmservo.plant import Command, Frame, Markers, Observation, Target
from rcmservo.safety import Gate
from rcmservo.servo import Servo, State
from rcmservo.states import Action, Cause, Mode, Phase, Request
from rcmservo.tool import RigidTool, ScaledTool

__version__ = "0.1.0"

__all__ = [
    "Action",
    "BadInput",
    "BroydenEstimator",
    "Cause",
    "Command",
    "Exploration",
    "FlowEstimator",
    "Frame",
    "Gate",
    "ImagedRcm",
    "JointLimits",
    "Markers",
    "Mode",
    "Observation",
    "Phase",
    "PitchYawRcm",
    "Plant",
    "ProjectionEstimator",
    "RcmServoError",
    "Request",
    "RigidTool",
    "SaturatedController",
    "ScaledTool",
    "Servo",
    "SphericalRcm",
    "State",
    "Target",
    "Thresholds",
    "Tick",
    "UnusableFile",
    "run",
    "teach",
    "ticks",
]


def __getattr__(name: str) -> ModuleType:
    """Load `rcmservo.sim` and `rcmservo.tracking` on first use: the core needs neither MuJoCo nor OpenCV."""
    if name in ("sim", "tracking"):
        return importlib.import_module(f"rcmservo.{name}")
    raise AttributeError(f"module 'rcmservo' has no attribute {name!r}")
