"""Messages and topics of CRTK as plain data, and the protocol of the transports that carry them.

CRTK (collaborative robotics toolkit) is a convention for topics and states of surgical robots in
ROS. Every message begins with ROS's header. Only its stamp is used: the sender's calendar time in
ns, 0 if invalid. `definition` holds the fields after the header as ROS defines them, and both
transports derive their encoding from it. CRTK has joints in rad and m; the functions at the end
convert them to and from rcmservo's rad and mm.

Sources: sensor_msgs and std_msgs of ROS; crtk_msgs of collaborative-robotics.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Floats
from rcmservo.recording.ros2_messages import SEPARATOR_LINE

CRTK_UNITS = np.array([1.0, 1.0, 1e-3])
"""Factors from rad, rad, mm to rad, rad, m."""
NESTED_TYPES = {
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
}
"""Definitions of the types of nested fields. A value of such a type is a tuple of its fields."""


class RosMessage(Protocol):
    """Message with a header."""

    ros_type: ClassVar[str]
    """Name of the ROS type, as package/Type."""
    definition: ClassVar[str]
    """Fields after the header, one line each with type and name."""

    @property
    def stamp(self) -> int:
        """Calendar time in ns, 0 if invalid."""
        ...


MessageT = TypeVar("MessageT", bound=RosMessage)


@dataclass(frozen=True)
class JointState:
    """Measured or commanded joints. A quantity that is not given is empty.

    Parameters
    ----------
    stamp : int
        Calendar time in ns.
    name : tuple[str, ...]
        Names of the joints.
    position : tuple[float, ...]
        Position of each joint in rad or m.
    velocity : tuple[float, ...]
        Velocity of each joint in rad/s or m/s.
    effort : tuple[float, ...]
        Torque or force of each joint in N m or N.
    """

    ros_type: ClassVar[str] = "sensor_msgs/JointState"
    """Name of the ROS type."""
    definition: ClassVar[str] = (
        "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    )
    """Fields after the header."""

    stamp: int
    name: tuple[str, ...] = ()
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()


@dataclass(frozen=True)
class PoseStamped:
    """Commanded pose of a tool.

    Parameters
    ----------
    stamp : int
        Calendar time in ns.
    pose : Any
        Position and quaternion, as in ``NESTED_TYPES``.
    """

    ros_type: ClassVar[str] = "geometry_msgs/PoseStamped"
    """Name of the ROS type."""
    definition: ClassVar[str] = "geometry_msgs/Pose pose"
    """Fields after the header."""

    stamp: int
    pose: Any = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


@dataclass(frozen=True)
class OperatingState:
    """Operating state of an arm.

    Parameters
    ----------
    stamp : int
        Calendar time in ns.
    state : str
        State: DISABLED, ENABLED, PAUSED or FAULT.
    is_homed : bool
        True if the arm knows its position.
    is_busy : bool
        True if the arm moves or is about to move.
    """

    ros_type: ClassVar[str] = "crtk_msgs/OperatingState"
    """Name of the ROS type."""
    definition: ClassVar[str] = "string state\nbool is_homed\nbool is_busy"
    """Fields after the header."""

    stamp: int
    state: str
    is_homed: bool = False
    is_busy: bool = False


@dataclass(frozen=True)
class StringStamped:
    """Command, warning or error as text.

    Parameters
    ----------
    stamp : int
        Calendar time in ns.
    string : str
        Text.
    """

    ros_type: ClassVar[str] = "crtk_msgs/StringStamped"
    """Name of the ROS type."""
    definition: ClassVar[str] = "string string"
    """Fields after the header."""

    stamp: int
    string: str


@dataclass(frozen=True)
class PlainImage:
    """Uncompressed image.

    Parameters
    ----------
    stamp : int
        Calendar time of the exposure in ns.
    height : int
        Number of rows.
    width : int
        Pixels per row.
    encoding : str
        Pixel format, such as bgr8.
    is_bigendian : int
        Byte order of numbers of several bytes: 1 for big-endian.
    step : int
        Bytes per row.
    data : bytes
        All rows.
    """

    ros_type: ClassVar[str] = "sensor_msgs/Image"
    """Name of the ROS type."""
    definition: ClassVar[str] = (
        "uint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data"
    )
    """Fields after the header."""

    stamp: int
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: bytes


@dataclass(frozen=True)
class CompressedImage:
    """Image as the content of an image file.

    Parameters
    ----------
    stamp : int
        Calendar time of the exposure in ns.
    format : str
        File format, jpeg or png; more words may follow.
    data : bytes
        Content of the file.
    """

    ros_type: ClassVar[str] = "sensor_msgs/CompressedImage"
    """Name of the ROS type."""
    definition: ClassVar[str] = "string format\nuint8[] data"
    """Fields after the header."""

    stamp: int
    format: str
    data: bytes


@dataclass(frozen=True)
class Topic(Generic[MessageT]):
    """Topic with the type of its messages and its quality of service.

    Parameters
    ----------
    name : str
        Name without a leading slash.
    kind : type[MessageT]
        Class of its messages.
    latched : bool
        True if a new subscriber gets the last messages.
    lossy : bool
        True if lost messages are not sent again (best effort).
    """

    name: str
    kind: type[MessageT]
    latched: bool = False
    lossy: bool = False

    def under(self, namespace: str) -> "Topic[MessageT]":
        """Return the topic of the arm with this namespace."""
        return replace(self, name=f"{namespace}/{self.name}")


MEASURED_JS = Topic("measured_js", JointState)
SETPOINT_JS = Topic("setpoint_js", JointState)
SERVO_JP = Topic("servo_jp", JointState)
SERVO_JV = Topic("servo_jv", JointState)
MOTION_TOPICS: list[Topic[Any]] = [
    *(
        Topic(name, JointState, lossy=True)
        for name in ("servo_jp", "servo_jr", "servo_jv", "servo_jf", "move_jp", "move_jr")
    ),
    *(Topic(name, PoseStamped, lossy=True) for name in ("servo_cp", "move_cp")),
]
"""Topics that move an arm: by joint position (jp), relative joint position (jr), joint velocity
(jv), joint force (jf) or pose of the tool (cp). A best-effort subscriber receives from reliable and
best-effort publishers."""
OPERATING_STATE = Topic("operating_state", OperatingState, latched=True)
STATE_COMMAND = Topic("state_command", StringStamped)
WARNING = Topic("warning", StringStamped)
ERROR = Topic("error", StringStamped)
IMAGE_TOPIC = Topic("camera/image_raw", PlainImage, lossy=True)


MessageHandler = Callable[[MessageT, str], None]
"""Function that gets each message with a name of its writer, in a thread of the transport. It must
return soon and raise nothing."""


class NoTransport(RcmServoError):
    """Error of a missing ROS package or an unusable network."""


class Transport(Protocol):
    """Publishers and subscribers of topics. A transport does not receive its own messages."""

    def publish(self, topic: Topic[MessageT], message: MessageT) -> bool:
        """Send a message at once; return True if it was sent.

        The first message of a topic also offers the topic.
        """
        ...

    def subscribe(self, topic: Topic[MessageT], handler: MessageHandler[MessageT]) -> None:
        """Pass every message on a topic to a handler. Malformed messages are dropped."""
        ...

    def offer(self, topic: Topic[Any]) -> None:
        """Advertise a topic before its first message: subscribers need a moment to find it."""
        ...

    def count_listeners(self, topic: Topic[Any]) -> int:
        """Return the number of subscribers to a topic."""
        ...

    def close(self) -> None:
        """Close all publishers and subscribers."""
        ...


def message_fields(kind: type[RosMessage]) -> list[tuple[str, str]]:
    """Return type and name of the fields after the header."""
    return parse_fields(kind.definition)


def parse_fields(definition: str) -> list[tuple[str, str]]:
    """Return type and name in each line of a definition."""
    return [(field_type, name) for field_type, name in map(str.split, definition.splitlines())]


def complete_definition(kind: type[RosMessage], header_definition: str) -> str:
    """Return the definition of a message with those of its header and nested types."""
    nested = "".join(
        f"{SEPARATOR_LINE}MSG: {name}\n{definition}\n" for name, definition in NESTED_TYPES.items()
    )
    return f"std_msgs/Header header\n{kind.definition}\n{header_definition}{nested}"


def read_message(kind: type[MessageT], stamp: int, received: Any) -> MessageT:
    """Return a message with the fields of a ROS library's object, as plain data."""
    values = {
        name: _to_plain(type_, getattr(received, name)) for type_, name in message_fields(kind)
    }
    create: Any = kind
    return create(stamp=stamp, **values)


def _to_plain(field_type: str, value: Any) -> Any:
    """Convert the value of a field to tuples, bytes and plain numbers."""
    if field_type in NESTED_TYPES:
        fields = parse_fields(NESTED_TYPES[field_type])
        return tuple(_to_plain(inner_type, getattr(value, name)) for inner_type, name in fields)
    if field_type == "uint8[]":
        return bytes(value)
    if field_type == "float64[]":
        return tuple(np.asarray(value, float).tolist())
    return tuple(value) if field_type == "string[]" else value


def to_rad_mm(position: tuple[float, ...], signs: Floats) -> Floats:
    """Convert an arm's first three joints (rad, rad, m) to q (3,) in rad, rad, mm."""
    return np.array(position[:3]) * signs / CRTK_UNITS


def to_rad_m(q: Floats, signs: Floats) -> tuple[float, ...]:
    """Convert joints or joint rates (3,) from rad, rad, mm to the arm's rad, rad, m."""
    return tuple((q * signs * CRTK_UNITS).tolist())
