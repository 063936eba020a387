"""Registry of the arms and cameras that a rig file can name.

To add a kind, write its settings class and its driver, and add a line to `DRIVERS`. A kind of
camera is also a member of the union `CameraSettings` in cameras/settings.py, where `known_latency`
must cover it. A driver is imported only when a device of its kind is opened.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.config.rig_file import RigDescription
from rcmservo.hardware.cameras.settings import (
    AravisSettings,
    OpencvSettings,
    TopicSettings,
    require_latency,
)
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.live.device_protocols import LabArm, LabCamera

DRIVERS: Mapping[type[Any], str] = {
    GalilSettings: "galil.driver:GalilArm",
    CrtkSettings: "crtk.arm:open_crtk_arm",
    OpencvSettings: "cameras.opencv:open_opencv_camera",
    AravisSettings: "cameras.aravis:open_aravis_camera",
    TopicSettings: "cameras.topic:open_topic_camera",
}
"""Module and function that open a device, by the class of its settings. Modules are relative to
rcmservo.hardware. The function takes the settings, and for an arm also the joint limits."""

ARM_KINDS = {kind.name: kind for kind in DRIVERS if hasattr(kind, "wiring")}
"""Settings classes of the arms, by kind."""

CAMERA_KINDS = {kind.name: kind for kind in DRIVERS if kind not in ARM_KINDS.values()}
"""Settings classes of the cameras, by kind."""


def open_arm(rig: RigDescription) -> LabArm:
    """Connect to the arm of a rig file, with its drive off.

    Parameters
    ----------
    rig : RigDescription
        Content of the rig file.

    Raises
    ------
    BadInput
        If the section [arm] is missing or invalid.
    RcmServoError
        If the arm cannot be reached or used.
    """
    settings = rig.decode_device_settings("arm", ARM_KINDS)
    return _import_driver(settings)(settings, rig.mechanism.limits)


def read_wiring(rig: RigDescription) -> Wiring:
    """Return the assignment of joints to motors in a rig file."""
    return rig.decode_device_settings("arm", ARM_KINDS).wiring


def open_camera(rig: RigDescription, accepts_unmeasured_latency: bool = False) -> LabCamera:
    """Open the camera of a rig file.

    Parameters
    ----------
    rig : RigDescription
        Content of the rig file.
    accepts_unmeasured_latency : bool
        True to accept a camera without a measured latency. Its exposure times then equal the
        arrivals.

    Raises
    ------
    BadInput
        If the section [camera] is missing or invalid, or the latency is not measured.
    CameraLost
        If the camera cannot be opened.
    """
    settings = rig.decode_device_settings("camera", CAMERA_KINDS)
    if not accepts_unmeasured_latency:
        require_latency(settings)
    return _import_driver(settings)(settings)


def _import_driver(settings: object) -> Callable[..., Any]:
    """Import the function that opens a device."""
    module, _, name = DRIVERS[type(settings)].partition(":")
    return getattr(import_module(f"rcmservo.hardware.{module}"), name)
