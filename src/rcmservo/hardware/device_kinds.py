"""Registry of the arms and cameras that a rig file can name, and the devices of a rig file.

To add a kind, write its settings class and its driver, and add a line to `DRIVERS`. A kind of
camera is also a member of the union `CameraSettings` in cameras/settings.py, where `known_latency`
must cover it. A driver is imported only when a device of its kind is opened.

A rig file can also name a user-defined arm, camera or tracker as module:class (user_devices.py).
"""

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.config.class_registry import KIND_KEY
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import require, suggest_name
from rcmservo.hardware.cameras.settings import (
    AravisSettings,
    OpencvSettings,
    TopicSettings,
    known_latency,
    require_latency,
)
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.hardware.user_devices import (
    UserDevice,
    adapt_arm,
    adapt_camera,
    construct_user_device,
    name_rig_file,
    read_user_device,
)
from rcmservo.interfaces import Tracker
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


def read_arm(rig: RigDescription) -> Any:
    """Return the settings of the arm of a rig file, or its user-defined arm as a `UserDevice`.

    Nothing is connected, but the module of a user-defined arm is imported.

    Raises
    ------
    BadInput
        If the section [arm] is missing or invalid.
    """
    return _read_device(rig, "arm", ARM_KINDS)


def read_camera(rig: RigDescription) -> Any:
    """Return the settings of the camera of a rig file, or its user-defined camera.

    Nothing is opened, but the module of a user-defined camera is imported.

    Raises
    ------
    BadInput
        If the section [camera] is missing or invalid.
    """
    return _read_device(rig, "camera", CAMERA_KINDS)


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
    settings = read_arm(rig)
    if isinstance(settings, UserDevice):
        return adapt_arm(construct_user_device(rig, settings))
    return _import_driver(settings)(settings, rig.mechanism.limits)


def read_wiring(rig: RigDescription) -> Wiring:
    """Return the assignment of joints to motors in a rig file."""
    return read_arm(rig).wiring


def read_latency(rig: RigDescription) -> tuple[float | None, bool]:
    """Return the latency of the camera of a rig file, and if the file has a key for it.

    Returns
    -------
    tuple
        Latency in s, None if it is not known, and True if [camera] has the key `latency`. A
        user-defined camera without this key reports exposure times that need no latency.
    """
    settings = read_camera(rig)
    if isinstance(settings, UserDevice):
        return settings.latency or 0.0, settings.latency is not None
    return known_latency(settings), True


def require_known_latency(rig: RigDescription) -> None:
    """Raise `BadInput` if the latency of the camera of a rig file is not known."""
    settings = read_camera(rig)
    if not isinstance(settings, UserDevice):
        require_latency(settings)


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
    settings = read_camera(rig)
    if isinstance(settings, UserDevice):
        return adapt_camera(construct_user_device(rig, settings))
    if not accepts_unmeasured_latency:
        require_latency(settings)
    return _import_driver(settings)(settings)


def make_tracker(rig: RigDescription) -> Tracker:
    """Return the tracker of a rig file: that of its section [tracker], or else `ColourMarkers`.

    Raises
    ------
    BadInput
        If the section [tracker] is invalid, or the constructor of its class raises an error.
    """
    device = _read_tracker(rig)
    if device is not None:
        return construct_user_device(rig, device)
    from rcmservo.tracking import ColourMarkers

    return ColourMarkers(rig.markers)


def prepare_tracker(rig: RigDescription) -> Callable[[], Tracker]:
    """Check the section [tracker], and return a function that makes the tracker in any process."""
    _read_tracker(rig)
    return partial(make_tracker, rig)


def _read_device(rig: RigDescription, section: str, kinds: Mapping[str, type[Any]]) -> Any:
    """Return the settings of a device, or the user-defined device that the file names."""
    device = read_user_device(rig, section)
    if device is not None:
        return device
    kind = rig.devices.get(section, {}).get(KIND_KEY)
    expected = f"one of {', '.join(kinds)}, or module:class such as my_lab:MyClass"
    is_known = not isinstance(kind, str) or kind in kinds
    require(is_known, f"{section}.{KIND_KEY}", kind, expected + suggest_name(kind, kinds))
    return rig.decode_device_settings(section, kinds)


def _read_tracker(rig: RigDescription) -> UserDevice | None:
    """Return the user-defined tracker of a rig file; None if the file has no [tracker]."""
    table = rig.devices.get("tracker")
    if table is None:
        return None
    with name_rig_file(rig):
        device = read_user_device(rig, "tracker")
        expected = "module:class such as my_lab:MyTracker; leave [tracker] out to detect [markers]"
        require(device is not None, f"tracker.{KIND_KEY}", table.get(KIND_KEY), expected)
    return device


def _import_driver(settings: object) -> Callable[..., Any]:
    """Import the function that opens a device."""
    module, _, name = DRIVERS[type(settings)].partition(":")
    return getattr(import_module(f"rcmservo.hardware.{module}"), name)
