"""Which camera it is and how it is set: a rig file's section [camera] with a kind.

What is left out is left as the camera has it; what is given is read back from the camera, which is
refused where it has taken something else.
"""

import ipaddress
import re
from dataclasses import dataclass
from typing import ClassVar

from rcmservo.errors import require
from rcmservo.hardware.crtk.settings import require_ros

LONGEST_LATENCY = 1.0
"""s: a camera later than that is of no use."""


@dataclass(frozen=True)
class OpencvSettings:
    """A camera that OpenCV reads: a video device, a file, a numbered sequence of pictures, or an
    address on the network. It tells no times."""

    name: ClassVar[str] = "opencv"
    """Its kind in rig files."""

    source: str
    """/dev/video0 or its number, a file, a sequence such as frames/%04d.png, or an address such as
    http://..."""
    latency: float = 0.0
    """s from the middle of an exposure to the frame's arrival; 0 where nobody has measured it."""
    width: int | None = None
    """px of the picture of a device."""
    height: int | None = None
    """px of the picture of a device."""
    frame_rate: float | None = None
    """Frames per s of a device; with which a file or sequence is played."""
    exposure: float | None = None
    """s for which a device exposes a frame."""
    gain: float | None = None
    """Of a device, in its own units."""

    def __post_init__(self) -> None:
        right = "a device, a file, a sequence of pictures, or an address"
        require(bool(self.source.strip()), "camera.source", self.source, right)
        _latency(self.latency)
        _picture(self.width, self.height, self.frame_rate, self.exposure)
        if not self.device:
            for name in ("width", "height", "exposure", "gain"):
                value = getattr(self, name)
                right = "left out: it can be set of a video device only"
                require(value is None, f"camera.{name}", value, right)
        if self.remote:
            right = "left out: what sends the pictures decides it"
            require(self.frame_rate is None, "camera.frame_rate", self.frame_rate, right)

    @property
    def device(self) -> bool:
        """Whether it is a video device of this computer."""
        return self.source.isdecimal() or self.source.startswith("/dev/")

    @property
    def remote(self) -> bool:
        """Whether it is an address on the network."""
        return "://" in self.source


@dataclass(frozen=True)
class AravisSettings:
    """A GigE Vision or USB3 Vision camera, by the Aravis library."""

    name: ClassVar[str] = "aravis"
    """Its kind in rig files."""

    address: str
    """Its address on the network, or its name as `arv-tool-0.8` lists it."""
    latency: float = 0.0
    """s from the middle of an exposure to the arrival of a frame that nothing delays; 0 where
    nobody has measured it. The camera's own times say how much later the others are."""
    width: int | None = None
    """px of the picture."""
    height: int | None = None
    """px of the picture."""
    frame_rate: float | None = None
    """Frames per s."""
    exposure: float | None = None
    """s for which a frame is exposed."""
    gain: float | None = None
    """In the camera's own units."""
    packet_size: int | None = None
    """Bytes of a packet on the network, as many as all of the way there carries; 1400 goes
    anywhere, and 9000 is taken where the camera is emulated on this computer."""

    def __post_init__(self) -> None:
        right = "an address or a name"
        require(bool(self.address.strip()), "camera.address", self.address, right)
        _latency(self.latency)
        _picture(self.width, self.height, self.frame_rate, self.exposure)
        size = self.packet_size
        right = "a whole number of bytes from 576 to 16000"
        require(size is None or 576 <= size <= 16000, "camera.packet_size", size, right)

    @property
    def bytes_of_packet(self) -> int:
        """The packet size that is asked for."""
        if self.packet_size is not None:
            return self.packet_size
        return 9000 if _is_this_computer(self.address) else 1400


@dataclass(frozen=True)
class TopicSettings:
    """A camera whose pictures come on a ROS topic, stamped when they were exposed."""

    name: ClassVar[str] = "topic"
    """Its kind in rig files."""

    topic: str
    """The topic's name, such as PSM1/camera/image_raw."""
    compressed: bool = False
    """Whether they come as the files of sensor_msgs/CompressedImage, not as sensor_msgs/Image."""
    ros: int = 2
    """Which ROS it speaks: 2 or 1."""
    domain: int = 0
    """ROS 2's domain (ROS_DOMAIN_ID)."""
    interface: str = "lo"
    """The network interface on which ROS 2 is spoken; lo is within this computer."""
    latency: float = 0.0
    """s from the middle of an exposure to the stamp."""

    def __post_init__(self) -> None:
        good = re.fullmatch(r"\w+(/\w+)*", self.topic, re.ASCII) is not None
        right = "a topic's name without a slash before it, such as PSM1/camera/image_raw"
        require(good, "camera.topic", self.topic, right)
        require_ros("camera", self.ros, self.domain, self.interface)
        _latency(self.latency)


CameraSettings = OpencvSettings | AravisSettings | TopicSettings


def known_latency(settings: CameraSettings) -> float | None:
    """s by which its frames are late, as its section says; None where nobody has measured it and no
    stamp of an exposure tells it."""
    stamped = isinstance(settings, TopicSettings)
    return settings.latency if stamped or settings.latency > 0.0 else None


def require_latency(settings: CameraSettings) -> None:
    """Refuse a camera whose latency nobody has measured."""
    right = "more than 0 s: `rcmservo rig check` measures it"
    known = known_latency(settings) is not None
    require(known, "camera.latency", settings.latency, right)


def _latency(latency: float) -> None:
    right = f"a time from 0 to {LONGEST_LATENCY:g} s (0 where it was never measured)"
    require(0.0 <= latency <= LONGEST_LATENCY, "camera.latency", latency, right)


def _picture(
    width: int | None, height: int | None, frame_rate: float | None, exposure: float | None
) -> None:
    for name, value in (("width", width), ("height", height)):
        right = "a whole number of px from 64 to 8192"
        require(value is None or 64 <= value <= 8192, f"camera.{name}", value, right)
    right = "from 1 to 1000 frames/s"
    good = frame_rate is None or 1.0 <= frame_rate <= 1000.0
    require(good, "camera.frame_rate", frame_rate, right)
    right = "a time from 0.00001 to 1 s"
    require(exposure is None or 1e-5 <= exposure <= 1.0, "camera.exposure", exposure, right)


def _is_this_computer(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def require_taken(name: str, wanted: float, taken: float, within: float) -> None:
    """Refuse a setting that the camera has not taken as it was given, to so large a share."""
    good = abs(taken - wanted) <= within * abs(wanted)
    require(good, f"camera.{name}", wanted, f"one that the camera takes (it makes {taken:g} of it)")
