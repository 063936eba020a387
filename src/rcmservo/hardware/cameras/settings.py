"""Which camera it is and how it is set: a rig file's section [camera] with a kind.

What is left out is left as the camera has it; what is given is read back from the camera, which is
refused where it has taken something else.
"""

import ipaddress
from dataclasses import dataclass
from typing import Annotated, ClassVar

from rcmservo.constraints import Checked, Limit, between, matching, not_empty
from rcmservo.errors import require
from rcmservo.hardware.crtk.settings import TOPIC, RosConnection

LATENCY = Limit(
    lambda latency: 0.0 <= latency <= 1.0, "a time from 0 to 1 s (0 where it was never measured)"
)
"""A camera that is later than 1 s is of no use."""

PIXELS = between(64, 8192, "a whole number of px")
FRAME_RATE = between(1.0, 1000.0, "a rate", "frames/s")
EXPOSURE = Limit(lambda exposure: 1e-5 <= exposure <= 1.0, "a time from 0.00001 to 1 s")


@dataclass(frozen=True)
class OpencvSettings(Checked, section="camera"):
    """A camera that OpenCV reads: a video device, a file, a numbered sequence of pictures, or an
    address on the network. It tells no times."""

    name: ClassVar[str] = "opencv"
    """Its kind in rig files."""

    source: Annotated[str, not_empty("a device, a file, a sequence of pictures, or an address")]
    """/dev/video0 or its number, a file, a sequence such as frames/%04d.png, or an address such as
    http://..."""
    latency: Annotated[float, LATENCY] = 0.0
    """s from the middle of an exposure to the frame's arrival; 0 where nobody has measured it."""
    width: Annotated[int | None, PIXELS] = None
    """px of the picture of a device."""
    height: Annotated[int | None, PIXELS] = None
    """px of the picture of a device."""
    frame_rate: Annotated[float | None, FRAME_RATE] = None
    """Frames per s of a device; with which a file or sequence is played."""
    exposure: Annotated[float | None, EXPOSURE] = None
    """s for which a device exposes a frame."""
    gain: float | None = None
    """Of a device, in its own units."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.device:
            for name in ("width", "height", "exposure", "gain"):
                right = "left out: it can be set of a video device only"
                self.require(getattr(self, name) is None, name, right)
        if self.remote:
            right = "left out: what sends the pictures decides it"
            self.require(self.frame_rate is None, "frame_rate", right)

    @property
    def device(self) -> bool:
        """Whether it is a video device of this computer."""
        return self.source.isdecimal() or self.source.startswith("/dev/")

    @property
    def remote(self) -> bool:
        """Whether it is an address on the network."""
        return "://" in self.source


@dataclass(frozen=True)
class AravisSettings(Checked, section="camera"):
    """A GigE Vision or USB3 Vision camera, by the Aravis library."""

    name: ClassVar[str] = "aravis"
    """Its kind in rig files."""

    address: Annotated[str, not_empty("an address or a name")]
    """Its address on the network, or its name as `arv-tool-0.8` lists it."""
    latency: Annotated[float, LATENCY] = 0.0
    """s from the middle of an exposure to the arrival of a frame that nothing delays; 0 where
    nobody has measured it. The camera's own times say how much later the others are."""
    width: Annotated[int | None, PIXELS] = None
    """px of the picture."""
    height: Annotated[int | None, PIXELS] = None
    """px of the picture."""
    frame_rate: Annotated[float | None, FRAME_RATE] = None
    """Frames per s."""
    exposure: Annotated[float | None, EXPOSURE] = None
    """s for which a frame is exposed."""
    gain: float | None = None
    """In the camera's own units."""
    packet_size: Annotated[int | None, between(576, 16000, "a whole number of bytes")] = None
    """Bytes of a packet on the network, as many as all of the way there carries; 1400 goes
    anywhere, and 9000 is taken where the camera is emulated on this computer."""

    @property
    def bytes_of_packet(self) -> int:
        """The packet size that is asked for."""
        if self.packet_size is not None:
            return self.packet_size
        return 9000 if _is_this_computer(self.address) else 1400


@dataclass(frozen=True)
class TopicSettings(RosConnection, section="camera"):
    """A camera whose pictures come on a ROS topic, stamped when they were exposed."""

    name: ClassVar[str] = "topic"
    """Its kind in rig files."""

    topic: Annotated[
        str,
        matching(TOPIC, "a topic's name without a slash before it, such as PSM1/camera/image_raw"),
    ]
    """The topic's name, such as PSM1/camera/image_raw."""
    compressed: bool = False
    """Whether they come as the files of sensor_msgs/CompressedImage, not as sensor_msgs/Image."""
    latency: Annotated[float, LATENCY] = 0.0
    """s from the middle of an exposure to the stamp."""


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


def _is_this_computer(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def require_taken(name: str, wanted: float, taken: float, within: float) -> None:
    """Refuse a setting that the camera has not taken as it was given, to so large a share."""
    good = abs(taken - wanted) <= within * abs(wanted)
    require(good, f"camera.{name}", wanted, f"one that the camera takes (it makes {taken:g} of it)")
