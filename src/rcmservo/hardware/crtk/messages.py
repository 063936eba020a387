"""What is said to and by an arm that speaks CRTK, as plain data, and the topics it is said on.

Every message begins with ROS's header, of which the stamp alone is kept: ns of the
sender's calendar time, 0 where it is not valid. What follows the header stands in `parts`, in the
words of ROS's own definitions, of which both transports make their wire form. Joints are in rad
and m as CRTK has them; `rcmservo`'s own rad and mm are made of them, and they of those, here.

Source: sensor_msgs and std_msgs of ROS; crtk_msgs of collaborative-robotics.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from rcmservo.interfaces import Floats

UNIT = np.array([1.0, 1.0, 1e-3])
"""rad, rad, m in one rad, rad, mm."""
NESTED = {
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
}
"""What the types have that are parts of messages: a value of one is a tuple of theirs."""


class RosMessage(Protocol):
    """Something said."""

    ros: ClassVar[str]
    """Its type's name in ROS, as package/Type."""
    parts: ClassVar[str]
    """Its parts behind the header, one a line: type and name."""

    @property
    def stamp(self) -> int:
        """ns of calendar time, 0 where it is not valid."""
        ...


Said = TypeVar("Said", bound=RosMessage)


@dataclass(frozen=True)
class JointState:
    """Where joints are, or shall be; what is not told is empty."""

    ros: ClassVar[str] = "sensor_msgs/JointState"
    """Its type."""
    parts: ClassVar[str] = "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    """What it has."""

    stamp: int
    """ns of calendar time."""
    name: tuple[str, ...] = ()
    """The joints' names."""
    position: tuple[float, ...] = ()
    """rad or m of each."""
    velocity: tuple[float, ...] = ()
    """rad/s or m/s of each."""
    effort: tuple[float, ...] = ()
    """N m or N of each."""


@dataclass(frozen=True)
class PoseStamped:
    """Where a tool shall be."""

    ros: ClassVar[str] = "geometry_msgs/PoseStamped"
    """Its type."""
    parts: ClassVar[str] = "geometry_msgs/Pose pose"
    """What it has."""

    stamp: int
    """ns of calendar time."""
    pose: Any = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    """Position and quaternion, as the parts of `NESTED` are."""


@dataclass(frozen=True)
class OperatingState:
    """How an arm is."""

    ros: ClassVar[str] = "crtk_msgs/OperatingState"
    """Its type."""
    parts: ClassVar[str] = "string state\nbool is_homed\nbool is_busy"
    """What it has."""

    stamp: int
    """ns of calendar time."""
    state: str
    """DISABLED, ENABLED, PAUSED or FAULT."""
    is_homed: bool = False
    """Whether it knows where it stands."""
    is_busy: bool = False
    """Whether it moves, or is about to."""


@dataclass(frozen=True)
class StringStamped:
    """Words."""

    ros: ClassVar[str] = "crtk_msgs/StringStamped"
    """Its type."""
    parts: ClassVar[str] = "string string"
    """What it has."""

    stamp: int
    """ns of calendar time."""
    string: str
    """The words."""


@dataclass(frozen=True)
class PlainImage:
    """A picture, row after row."""

    ros: ClassVar[str] = "sensor_msgs/Image"
    """Its type."""
    parts: ClassVar[str] = (
        "uint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data"
    )
    """What it has."""

    stamp: int
    """ns of calendar time: when it was exposed."""
    height: int
    """px."""
    width: int
    """px."""
    encoding: str
    """What its bytes are, such as bgr8."""
    is_bigendian: int
    """Whether numbers of several bytes begin with the greatest."""
    step: int
    """Bytes of a row."""
    data: bytes
    """All rows."""


@dataclass(frozen=True)
class CompressedImage:
    """A picture as the bytes of an image file."""

    ros: ClassVar[str] = "sensor_msgs/CompressedImage"
    """Its type."""
    parts: ClassVar[str] = "string format\nuint8[] data"
    """What it has."""

    stamp: int
    """ns of calendar time: when it was exposed."""
    format: str
    """jpeg or png, maybe with more words about it."""
    data: bytes
    """The file's."""


@dataclass(frozen=True)
class Topic(Generic[Said]):
    """A name under which messages of one kind are sent."""

    name: str
    """Without a slash before it."""
    kind: type[Said]
    """The class of its messages."""
    latched: bool = False
    """Whether who comes later is told the last ones too."""
    lossy: bool = False
    """Whether one that is lost on the way is not sent again."""

    def under(self, namespace: str) -> "Topic[Said]":
        """The same of one arm."""
        return replace(self, name=f"{namespace}/{self.name}")


MEASURED_JS = Topic("measured_js", JointState)
SETPOINT_JS = Topic("setpoint_js", JointState)
SERVO_JP = Topic("servo_jp", JointState)
SERVO_JV = Topic("servo_jv", JointState)
MOTIONS: list[Topic[Any]] = [
    *(Topic(f"{what}_j{of}", JointState, lossy=True) for what in ("servo", "move") for of in "pr"),
    *(Topic(f"servo_j{of}", JointState, lossy=True) for of in "vf"),
    *(Topic(f"{what}_cp", PoseStamped, lossy=True) for what in ("servo", "move")),
]
"""On which somebody may move an arm, heard whether it is sent again where it was lost or not."""
OPERATING_STATE = Topic("operating_state", OperatingState, latched=True)
STATE_COMMAND = Topic("state_command", StringStamped)
WARNING = Topic("warning", StringStamped)
ERROR = Topic("error", StringStamped)
PICTURES = Topic("camera/image_raw", PlainImage, lossy=True)


def parts_of(kind: type[RosMessage]) -> list[tuple[str, str]]:
    """Type and name of a message's parts behind the header."""
    return lines_of(kind.parts)


def lines_of(parts: str) -> list[tuple[str, str]]:
    """Type and name in each line."""
    found: list[tuple[str, str]] = []
    for line in parts.splitlines():
        form, name = line.split()
        found.append((form, name))
    return found


def in_rad_and_mm(position: tuple[float, ...], signs: Floats) -> Floats:
    """An arm's first three joints as q (3,) rad, rad, mm."""
    return np.array(position[:3]) * signs / UNIT


def in_rad_and_m(q: Floats, signs: Floats) -> tuple[float, ...]:
    """Joints or joint rates q (3,) rad, rad, mm as an arm has them."""
    values: Any = (q * signs * UNIT).tolist()
    return tuple(values)
