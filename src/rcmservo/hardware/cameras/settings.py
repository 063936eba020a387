"""Settings of cameras: the section [camera] of a rig file, with one class per kind of camera.

A setting that is left out stays as the camera has it. A given setting is read back from the camera,
and refused if the camera has a different value.
"""

import ipaddress
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from rcmservo.constraints import Checked, Limit, between, matching, not_empty
from rcmservo.errors import require
from rcmservo.hardware.crtk.settings import TOPIC_PATTERN, RosConnection

LATENCY = Limit(lambda s: 0.0 <= s <= 1.0, "a time from 0 to 1 s (0 if it is not measured)")
"""Range of a latency. A camera with more than 1 s is useless for the servo."""

IMAGE_SIZE = between(64, 8192, "a whole number of px")
FRAME_RATE = between(1.0, 1000.0, "a rate", "frames/s")
EXPOSURE_TIME = Limit(lambda s: 1e-5 <= s <= 1.0, "a time from 0.00001 to 1 s")
TOPIC_NAME = matching(
    TOPIC_PATTERN, "a topic's name without a slash before it, such as PSM1/camera/image_raw"
)


@dataclass(frozen=True)
class OpencvSettings(Checked, section="camera"):
    """Video device, video file, numbered image sequence or network address, read with OpenCV.

    Such a source has no time stamps.

    Parameters
    ----------
    source : str
        Device such as /dev/video0 or its number, file, sequence such as frames/%04d.png, or address
        such as http://...
    latency : float
        Time from the middle of the exposure to the frame's arrival, s; 0 if it is not measured.
    width : int or None
        Image width of a device, px.
    height : int or None
        Image height of a device, px.
    frame_rate : float or None
        Frame rate of a device, or playback rate of a file or sequence, frames/s.
    exposure : float or None
        Exposure time of a device, s.
    gain : float or None
        Gain of a device, in its own units.
    """

    name: ClassVar[str] = "opencv"
    """Kind of the camera in rig files."""

    source: Annotated[str, not_empty("a device, a file, a sequence of pictures, or an address")]
    latency: Annotated[float, LATENCY] = 0.0
    width: Annotated[int | None, IMAGE_SIZE] = None
    height: Annotated[int | None, IMAGE_SIZE] = None
    frame_rate: Annotated[float | None, FRAME_RATE] = None
    exposure: Annotated[float | None, EXPOSURE_TIME] = None
    gain: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.is_device:
            for name in ("width", "height", "exposure", "gain"):
                expected = "left out: only a video device has this setting"
                self.require(getattr(self, name) is None, name, expected)
        if self.is_remote:
            expected = "left out: the sender of the images sets it"
            self.require(self.frame_rate is None, "frame_rate", expected)

    @property
    def is_device(self) -> bool:
        """True for a video device of this computer."""
        return self.source.isdecimal() or self.source.startswith("/dev/")

    @property
    def is_remote(self) -> bool:
        """True for a network address."""
        return "://" in self.source

    @property
    def is_live(self) -> bool:
        """True if the camera sends frames at its own rate, False for a file or a sequence."""
        return self.is_device or self.is_remote


@dataclass(frozen=True)
class AravisSettings(Checked, section="camera"):
    """GigE Vision or USB3 Vision camera, read with the Aravis library.

    Parameters
    ----------
    address : str
        IP address, or name as `arv-tool-0.8` lists it.
    latency : float
        Time from the middle of the exposure to the arrival of an undelayed frame, s; 0 if it is not
        measured. The camera's time stamps give the delays of the other frames.
    width : int or None
        Image width, px.
    height : int or None
        Image height, px.
    frame_rate : float or None
        Frame rate, frames/s.
    exposure : float or None
        Exposure time, s.
    gain : float or None
        Gain in the camera's own units.
    packet_size : int or None
        Packet size in bytes that the whole network path supports. By default 1400, which every
        network supports, or 9000 for an emulated camera on this computer.
    """

    name: ClassVar[str] = "aravis"
    """Kind of the camera in rig files."""

    address: Annotated[str, not_empty("an address or a name")]
    latency: Annotated[float, LATENCY] = 0.0
    width: Annotated[int | None, IMAGE_SIZE] = None
    height: Annotated[int | None, IMAGE_SIZE] = None
    frame_rate: Annotated[float | None, FRAME_RATE] = None
    exposure: Annotated[float | None, EXPOSURE_TIME] = None
    gain: float | None = None
    packet_size: Annotated[int | None, between(576, 16000, "a whole number of bytes")] = None

    @property
    def effective_packet_size(self) -> int:
        """Requested packet size in bytes."""
        if self.packet_size is not None:
            return self.packet_size
        return 9000 if _is_loopback(self.address) else 1400


@dataclass(frozen=True)
class TopicSettings(RosConnection, section="camera"):
    """Camera that publishes images on a ROS topic, stamped with their exposure times.

    Parameters
    ----------
    topic : str
        Name of the topic, such as PSM1/camera/image_raw.
    compressed : bool
        True for sensor_msgs/CompressedImage, false for sensor_msgs/Image.
    latency : float
        Time from the middle of the exposure to the stamp, s.
    """

    name: ClassVar[str] = "topic"
    """Kind of the camera in rig files."""

    topic: Annotated[str, TOPIC_NAME]
    compressed: bool = False
    latency: Annotated[float, LATENCY] = 0.0


CameraSettings = OpencvSettings | AravisSettings | TopicSettings


def known_latency(settings: CameraSettings) -> float | None:
    """Return the latency of a camera in s, None if it is neither measured nor stamped."""
    stamped = isinstance(settings, TopicSettings)
    return settings.latency if stamped or settings.latency > 0.0 else None


def require_latency(settings: CameraSettings) -> None:
    """Raise `BadInput` if the latency of a camera is not known."""
    expected = "more than 0 s: `rcmservo rig check` measures it"
    known = known_latency(settings) is not None
    require(known, "camera.latency", settings.latency, expected)


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def set_parameters(
    parameters: Sequence[tuple[str, Any, float | None, float, float]],
    set_value: Callable[[Any, float], object],
    read_value: Callable[[Any], float],
) -> None:
    """Set the parameters of a camera that have a value, then read them back.

    All are set before the first is read: the exposure limits the frame rate, and some cameras
    shorten the exposure for a higher rate.

    Parameters
    ----------
    parameters : sequence of tuple
        Name of the setting, key of the driver's parameter, value or None, units of the driver's
        parameter per unit of the setting, and largest accepted relative difference.
    set_value, read_value : callable
        Functions of the driver that set and return a parameter, by its key.

    Raises
    ------
    BadInput
        If the camera has another value afterwards.
    """
    for _, key, value, scale, _ in parameters:
        if value is not None:
            set_value(key, value * scale)
    for name, key, value, scale, tolerance in parameters:
        if value is not None:
            require_accepted(name, value, read_value(key) / scale, tolerance)


def require_accepted(name: str, value: float, actual: float, tolerance: float) -> None:
    """Raise `BadInput` if a camera's actual value differs from its setting.

    `tolerance` is the largest accepted relative difference.
    """
    accepted = abs(actual - value) <= tolerance * abs(value)
    expected = f"a value that the camera accepts (it has set {actual:g})"
    require(accepted, f"camera.{name}", value, expected)
