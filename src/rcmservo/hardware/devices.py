"""The arms and cameras that a rig file can name, and how each is opened."""

from rcmservo.config.rig_file import Lab
from rcmservo.hardware.cameras.opencv import opencv_camera
from rcmservo.hardware.cameras.settings import AravisSettings, OpencvSettings, require_latency
from rcmservo.hardware.galil.driver import GalilArm
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.live.lab import LabArm, LabCamera

ARMS = {kind.name: kind for kind in (GalilSettings,)}
"""The settings of every arm, by its kind in a rig file."""

CAMERAS = {kind.name: kind for kind in (OpencvSettings, AravisSettings)}
"""The settings of every camera, by its kind in a rig file."""


def open_arm(lab: Lab) -> LabArm:
    """Connect to the arm of a rig file, with its drive off."""
    match lab.device("arm", ARMS):
        case GalilSettings() as settings:
            return GalilArm(settings, lab.mechanism.limits)
        case other:
            raise NotImplementedError(type(other).__name__)


def open_camera(lab: Lab, unmeasured: bool = False) -> LabCamera:
    """Open the camera of a rig file. One whose latency nobody has measured is refused, but to who
    measures it: its exposures are told as if they were the arrivals."""
    settings = lab.device("camera", CAMERAS)
    if not unmeasured:
        require_latency(settings)
    match settings:
        case OpencvSettings():
            return opencv_camera(settings)
        case other:
            raise NotImplementedError(type(other).__name__)
