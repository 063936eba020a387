"""The arms and cameras that a rig file can name, and how each is opened. A driver is imported only
when a device of its kind is opened."""

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.config.rig_file import Lab
from rcmservo.hardware.cameras.settings import (
    AravisSettings,
    OpencvSettings,
    TopicSettings,
    require_latency,
)
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.live.lab import LabArm, LabCamera

ARMS = {kind.name: kind for kind in (GalilSettings, CrtkSettings)}
"""The settings of every arm, by its kind in a rig file."""

CAMERAS = {kind.name: kind for kind in (OpencvSettings, AravisSettings, TopicSettings)}
"""The settings of every camera, by its kind in a rig file."""


def open_arm(lab: Lab) -> LabArm:
    """Connect to the arm of a rig file, with its drive off."""
    match lab.device("arm", ARMS):
        case GalilSettings() as settings:
            from rcmservo.hardware.galil.driver import GalilArm

            return GalilArm(settings, lab.mechanism.limits)
        case CrtkSettings() as settings:
            from rcmservo.hardware.crtk.arm import CrtkArm
            from rcmservo.hardware.crtk.connection import open_transport

            transport = open_transport(settings.ros, settings.domain, settings.interface)
            return CrtkArm(settings, lab.mechanism.limits, transport)
        case other:
            raise NotImplementedError(type(other).__name__)


def wiring_of(lab: Lab) -> Wiring:
    """What the rig file says of its arm's motors."""
    match lab.device("arm", ARMS):
        case GalilSettings() as settings:
            return Wiring(settings.counts, axes=settings.axes)
        case CrtkSettings() as settings:
            return Wiring(settings.signs, "signs")
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
            from rcmservo.hardware.cameras.opencv import opencv_camera

            return opencv_camera(settings)
        case AravisSettings():
            from rcmservo.hardware.cameras.aravis import aravis_camera

            return aravis_camera(settings)
        case TopicSettings():
            from rcmservo.hardware.cameras.topic import topic_camera

            return topic_camera(settings)
        case other:
            raise NotImplementedError(type(other).__name__)
