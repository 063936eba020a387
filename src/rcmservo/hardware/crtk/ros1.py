"""ROS 1 transport over rospy from Debian's packages, with a running master.

rospy is plain Python, so any Python of the computer can import it from Debian's folder. Message
classes are generated from their definitions, without a build. A process is one node.
"""

import contextlib
import functools
import os
import sys
import uuid
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from rcmservo.errors import one_line
from rcmservo.hardware.crtk.messages import (
    NESTED_TYPES,
    MessageHandler,
    MessageT,
    NoTransport,
    RosMessage,
    Topic,
    message_fields,
    parse_fields,
)

DEBIAN_PACKAGES_PATH = "/usr/lib/python3/dist-packages"
DEBIAN_PACKAGES = "ros-core python3-rospy"
NS_PER_S = 1_000_000_000
QUEUE_SIZE = 10
"""Messages that wait for a publisher or subscriber."""
SEQUENCE_TYPES = "string[]", "float64[]"
SEPARATOR = "=" * 80 + "\n"
HEADER_DEFINITION = SEPARATOR + "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"


@functools.cache
def rospy() -> Any:
    """Import rospy and make this process a node."""
    if find_spec("rospy") is None and DEBIAN_PACKAGES_PATH not in sys.path:
        sys.path.append(DEBIAN_PACKAGES_PATH)
    try:
        ros: Any = import_module("rospy")
        rosgraph: Any = import_module("rosgraph")
    except ImportError as error:
        text = f"ROS 1 needs rospy, which is not installed: apt-get install {DEBIAN_PACKAGES}"
        raise NoTransport(text) from error
    if not rosgraph.is_master_online():
        where = os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
        raise NoTransport(
            f"no ROS 1 master answers at {where}: start roscore, or set ROS_MASTER_URI"
        )
    ros.init_node(f"rcmservo_{uuid.uuid4().hex[:12]}", disable_signals=True)
    return ros


@functools.cache
def message_class(kind: type[RosMessage]) -> Any:
    """Return the generated rospy class of a message type."""
    dynamic: Any = import_module("genpy.dynamic")
    nested = "".join(
        f"{SEPARATOR}MSG: {name}\n{definition}\n" for name, definition in NESTED_TYPES.items()
    )
    text = f"std_msgs/Header header\n{kind.definition}\n{HEADER_DEFINITION}{nested}"
    return dynamic.generate_dynamic(kind.ros_type, text)[kind.ros_type]


class Ros1:
    """Topics of this process's node.

    Raises
    ------
    NoTransport
        If rospy is not installed or no master answers.
    """

    def __init__(self) -> None:
        self._ros = rospy()
        self._publishers: dict[str, Any] = {}
        self._subscribers: list[Any] = []

    def publish(self, topic: Topic[MessageT], message: MessageT) -> bool:
        ros_message: Any = message_class(topic.kind)()
        ros_message.header.stamp = self._ros.Time(*divmod(message.stamp, NS_PER_S))
        for field_type, name in message_fields(topic.kind):
            _set_field(ros_message, field_type, name, getattr(message, name))
        try:
            self._publisher(topic).publish(ros_message)
        except self._ros.ROSException:
            return False
        return True

    def offer(self, topic: Topic[Any]) -> None:
        self._publisher(topic)

    def listeners(self, topic: Topic[Any]) -> int:
        return self._publisher(topic).get_num_connections()

    def subscribe(self, topic: Topic[MessageT], handler: MessageHandler[MessageT]) -> None:
        own_name: str = self._ros.get_name()

        def receive(ros_message: Any) -> None:
            writer: str = ros_message._connection_header["callerid"]
            if writer != own_name:
                handler(_from_ros(topic.kind, ros_message), writer)

        subscriber = self._ros.Subscriber(
            f"/{topic.name}",
            message_class(topic.kind),
            receive,
            queue_size=QUEUE_SIZE,
            tcp_nodelay=True,
        )
        self._subscribers.append(subscriber)

    def close(self) -> None:
        with contextlib.suppress(self._ros.ROSException):
            for one in (*self._subscribers, *self._publishers.values()):
                one.unregister()

    def _publisher(self, topic: Topic[Any]) -> Any:
        if topic.name not in self._publishers:
            try:
                self._publishers[topic.name] = self._ros.Publisher(
                    f"/{topic.name}",
                    message_class(topic.kind),
                    queue_size=QUEUE_SIZE,
                    latch=topic.latched,
                    tcp_nodelay=True,
                )
            except self._ros.ROSException as error:
                raise NoTransport(
                    f"{topic.name} cannot be advertised: {one_line(error)}"
                ) from error
        return self._publishers[topic.name]


def _from_ros(kind: type[MessageT], ros_message: Any) -> MessageT:
    """Convert a message of rospy to plain data."""
    values = {
        name: _to_plain_value(field_type, getattr(ros_message, name))
        for field_type, name in message_fields(kind)
    }
    create: Any = kind
    return create(stamp=ros_message.header.stamp.to_nsec(), **values)


def _to_plain_value(field_type: str, value: Any) -> Any:
    if field_type in NESTED_TYPES:
        fields = parse_fields(NESTED_TYPES[field_type])
        return tuple(_to_plain_value(inner, getattr(value, name)) for inner, name in fields)
    return tuple(value) if field_type in SEQUENCE_TYPES else value


def _set_field(ros_message: Any, field_type: str, name: str, value: Any) -> None:
    """Set a field of a rospy message, field by field for nested types."""
    if field_type not in NESTED_TYPES:
        setattr(ros_message, name, value)
        return
    fields = parse_fields(NESTED_TYPES[field_type])
    for (inner_type, inner_name), one in zip(fields, value, strict=True):
        _set_field(getattr(ros_message, name), inner_type, inner_name, one)
