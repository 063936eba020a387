"""ROS 1 transport of CRTK messages over rospy from Debian's packages, with a running master.

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

from rcmservo.errors import shorten_to_line
from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.messages import MessageHandler, MessageT, NoTransport, RosMessage, Topic
from rcmservo.recording.ros2_messages import SEPARATOR_LINE

DEBIAN_PACKAGES_PATH = "/usr/lib/python3/dist-packages"
DEBIAN_PACKAGES = "ros-core python3-rospy"
NS_PER_S = 1_000_000_000
CONNECTION_OPTIONS = {"queue_size": 10, "tcp_nodelay": True}
"""Options of publishers and subscribers. Ten messages can wait, and each is sent at once."""
HEADER_DEFINITION = f"""{SEPARATOR_LINE}MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""


@functools.cache
def start_node() -> Any:
    """Import rospy, make this process a node, and return the module."""
    if find_spec("rospy") is None and DEBIAN_PACKAGES_PATH not in sys.path:
        sys.path.append(DEBIAN_PACKAGES_PATH)
    try:
        ros: Any = import_module("rospy")
        rosgraph: Any = import_module("rosgraph")
    except ImportError as error:
        text = f"ROS 1 needs rospy, which is not installed: apt-get install {DEBIAN_PACKAGES}"
        raise NoTransport(text) from error
    if not rosgraph.is_master_online():
        uri = os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
        raise NoTransport(f"no ROS 1 master answers at {uri}: start roscore, or set ROS_MASTER_URI")
    ros.init_node(f"rcmservo_{uuid.uuid4().hex[:12]}", disable_signals=True)
    return ros


@functools.cache
def generate_class(kind: type[RosMessage]) -> Any:
    """Return the generated rospy class of a message type."""
    dynamic: Any = import_module("genpy.dynamic")
    definition = messages.complete_definition(kind, HEADER_DEFINITION)
    return dynamic.generate_dynamic(kind.ros_type, definition)[kind.ros_type]


class Ros1:
    """Topics of this process's node.

    Raises
    ------
    NoTransport
        If rospy is not installed or no master answers.
    """

    def __init__(self) -> None:
        self._ros = start_node()
        self._publishers: dict[str, Any] = {}
        self._subscribers: list[Any] = []

    def publish(self, topic: Topic[MessageT], message: MessageT) -> bool:
        ros_message: Any = generate_class(topic.kind)()
        ros_message.header.stamp = self._ros.Time(*divmod(message.stamp, NS_PER_S))
        for field_type, name in messages.message_fields(topic.kind):
            _set_field(ros_message, field_type, name, getattr(message, name))
        try:
            self._publisher(topic).publish(ros_message)
        except self._ros.ROSException:
            return False
        return True

    def offer(self, topic: Topic[Any]) -> None:
        self._publisher(topic)

    def count_listeners(self, topic: Topic[Any]) -> int:
        return self._publisher(topic).get_num_connections()

    def subscribe(self, topic: Topic[MessageT], handler: MessageHandler[MessageT]) -> None:
        own_name: str = self._ros.get_name()

        def receive(ros_message: Any) -> None:
            writer: str = ros_message._connection_header["callerid"]
            if writer != own_name:
                stamp: int = ros_message.header.stamp.to_nsec()
                handler(messages.read_message(topic.kind, stamp, ros_message), writer)

        ros_class = generate_class(topic.kind)
        subscriber = self._ros.Subscriber(
            f"/{topic.name}", ros_class, receive, **CONNECTION_OPTIONS
        )
        self._subscribers.append(subscriber)

    def close(self) -> None:
        with contextlib.suppress(self._ros.ROSException):
            for endpoint in (*self._subscribers, *self._publishers.values()):
                endpoint.unregister()

    def _publisher(self, topic: Topic[Any]) -> Any:
        if topic.name not in self._publishers:
            options = CONNECTION_OPTIONS | {"latch": topic.latched}
            try:
                publisher = self._ros.Publisher(
                    f"/{topic.name}", generate_class(topic.kind), **options
                )
            except self._ros.ROSException as error:
                text = f"{topic.name} cannot be advertised: {shorten_to_line(error)}"
                raise NoTransport(text) from error
            self._publishers[topic.name] = publisher
        return self._publishers[topic.name]


def _set_field(ros_message: Any, field_type: str, name: str, value: Any) -> None:
    """Set a field of a rospy message, field by field for nested types."""
    if field_type not in messages.NESTED_TYPES:
        setattr(ros_message, name, value)
        return
    fields = messages.parse_fields(messages.NESTED_TYPES[field_type])
    for (inner_type, inner_name), inner_value in zip(fields, value, strict=True):
        _set_field(getattr(ros_message, name), inner_type, inner_name, inner_value)
