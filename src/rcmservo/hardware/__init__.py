"""Drivers of arms and cameras, and emulators of them that need no hardware.

A rig file names its devices by a kind, and `rcmservo.load_rig` opens them; the names here are for
programs that open one by itself. A driver takes the settings of its section in the rig file, and an
arm also its joint limits::

    settings = rs.hardware.GalilSettings(address="192.168.1.7", counts=(2e5, 2e5, 1e3))
    arm = rs.hardware.GalilArm(settings, rs.SphericalRcm().limits)

- Arms: ``GalilArm(settings, limits)`` with `GalilSettings`; ``open_crtk_arm(settings, limits)``
  with `CrtkSettings`. Both connect with the drive off.
- Cameras: ``open_opencv_camera(settings)`` with `OpencvSettings`, ``open_aravis_camera(settings)``
  with `AravisSettings`, ``open_topic_camera(settings)`` with `TopicSettings`.
- Emulators: ``GalilServer(GalilController(motors, axes))``, a Galil controller on a socket;
  `CrtkDevice`, an arm on ROS topics; `MjpegServer`, a camera in the network; `GigeCamera`, a GigE
  Vision camera. ``rcmservo emulate`` starts them with a simulated arm.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rcmservo.hardware.cameras.aravis import open_aravis_camera
    from rcmservo.hardware.cameras.emulated.gige_camera import GigeCamera
    from rcmservo.hardware.cameras.emulated.mjpeg_server import MjpegServer
    from rcmservo.hardware.cameras.opencv import open_opencv_camera
    from rcmservo.hardware.cameras.settings import AravisSettings, OpencvSettings, TopicSettings
    from rcmservo.hardware.cameras.topic import open_topic_camera
    from rcmservo.hardware.crtk.arm import open_crtk_arm
    from rcmservo.hardware.crtk.device import CrtkDevice
    from rcmservo.hardware.crtk.settings import CrtkSettings
    from rcmservo.hardware.galil.driver import GalilArm
    from rcmservo.hardware.galil.emulator.controller import GalilController
    from rcmservo.hardware.galil.emulator.server import GalilServer
    from rcmservo.hardware.galil.settings import GalilSettings

MODULES = {
    "AravisSettings": "cameras.settings",
    "CrtkDevice": "crtk.device",
    "CrtkSettings": "crtk.settings",
    "GalilArm": "galil.driver",
    "GalilController": "galil.emulator.controller",
    "GalilServer": "galil.emulator.server",
    "GalilSettings": "galil.settings",
    "GigeCamera": "cameras.emulated.gige_camera",
    "MjpegServer": "cameras.emulated.mjpeg_server",
    "OpencvSettings": "cameras.settings",
    "TopicSettings": "cameras.settings",
    "open_aravis_camera": "cameras.aravis",
    "open_crtk_arm": "crtk.arm",
    "open_opencv_camera": "cameras.opencv",
    "open_topic_camera": "cameras.topic",
}
"""Module of each public name. It is imported on first use, because a driver needs its library."""

__all__ = [
    "AravisSettings",
    "CrtkDevice",
    "CrtkSettings",
    "GalilArm",
    "GalilController",
    "GalilServer",
    "GalilSettings",
    "GigeCamera",
    "MjpegServer",
    "OpencvSettings",
    "TopicSettings",
    "open_aravis_camera",
    "open_crtk_arm",
    "open_opencv_camera",
    "open_topic_camera",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name not in MODULES:
        raise AttributeError(f"module 'rcmservo.hardware' has no attribute {name!r}")
    return getattr(import_module(f"rcmservo.hardware.{MODULES[name]}"), name)
