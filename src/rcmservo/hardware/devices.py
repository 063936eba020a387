"""The arms and cameras that a rig file can name, and how each is opened."""

from rcmservo.config.rig_file import Lab
from rcmservo.hardware.crtk.arm import CrtkArm
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.crtk.transport import opened
from rcmservo.hardware.galil.driver import GalilArm
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.live.lab import LabArm

ARMS = {kind.name: kind for kind in (GalilSettings, CrtkSettings)}
"""The settings of every arm, by its kind in a rig file."""


def open_arm(lab: Lab) -> LabArm:
    """Connect to the arm of a rig file, with its drive off."""
    match lab.device("arm", ARMS):
        case GalilSettings() as settings:
            return GalilArm(settings, lab.mechanism.limits)
        case CrtkSettings() as settings:
            transport = opened(settings.ros, settings.domain, settings.interface)
            return CrtkArm(settings, lab.mechanism.limits, transport)
        case other:
            raise NotImplementedError(type(other).__name__)
