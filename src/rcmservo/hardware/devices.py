"""Registry of the arms and cameras that a rig file can name. A driver is imported only when a
device of its kind is opened."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

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

DRIVERS: Mapping[type[Any], str] = {
    GalilSettings: "galil.driver:GalilArm",
    CrtkSettings: "crtk.arm:crtk_arm",
    OpencvSettings: "cameras.opencv:opencv_camera",
    AravisSettings: "cameras.aravis:aravis_camera",
    TopicSettings: "cameras.topic:topic_camera",
}
"""By the settings of a device, the driver below rcmservo.hardware that opens it, one a line. The
driver of an arm takes the joints' limits too."""

ARMS = {kind.name: kind for kind in DRIVERS if hasattr(kind, "wiring")}
"""The settings of every arm, by its kind in a rig file."""

CAMERAS = {kind.name: kind for kind in DRIVERS if kind not in ARMS.values()}
"""The settings of every camera, by its kind in a rig file."""


def _driver(settings: object) -> Callable[..., Any]:
    """Import the driver of a device."""
    module, _, name = DRIVERS[type(settings)].partition(":")
    return getattr(import_module(f"rcmservo.hardware.{module}"), name)


def open_arm(lab: Lab) -> LabArm:
    """Connect to the arm of a rig file, with its drive off."""
    settings = lab.device("arm", ARMS)
    return _driver(settings)(settings, lab.mechanism.limits)


def wiring_of(lab: Lab) -> Wiring:
    """Return what the rig file says of its arm's motors."""
    return lab.device("arm", ARMS).wiring


def open_camera(lab: Lab, unmeasured: bool = False) -> LabCamera:
    """Open the camera of a rig file. One whose latency nobody has measured is refused unless
    ``unmeasured``: its exposures are reported as if they were the arrivals."""
    settings = lab.device("camera", CAMERAS)
    if not unmeasured:
        require_latency(settings)
    return _driver(settings)(settings)
