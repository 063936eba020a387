"""ROS 1, by the rospy of Debian's packages and a master that runs somewhere.

rospy is plain Python, so that any Python of the computer can use it where Debian put it. Messages
are made from their definitions: nothing has to be built. One process is one node.
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
from rcmservo.hardware.crtk.messages import NESTED, RosMessage, Said, Topic, lines_of, parts_of
from rcmservo.hardware.crtk.transport import Heard, NoTransport

DEBIAN = "/usr/lib/python3/dist-packages"
PACKAGES = "ros-core python3-rospy"
SECOND = 1_000_000_000
DEPTH = 10
"""Messages that wait to be sent."""
SEQUENCES = "string[]", "float64[]"
LINE = "=" * 80 + "\n"
HEADER = LINE + "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"


@functools.cache
def rospy() -> Any:
    """rospy, with this process as a node."""
    if find_spec("rospy") is None and DEBIAN not in sys.path:
        sys.path.append(DEBIAN)
    try:
        ros: Any = import_module("rospy")
        rosgraph: Any = import_module("rosgraph")
    except ImportError as error:
        words = f"ROS 1 needs rospy, which is not installed: apt-get install {PACKAGES}"
        raise NoTransport(words) from error
    if not rosgraph.is_master_online():
        where = os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
        raise NoTransport(
            f"no ROS 1 master answers at {where}: start roscore, or set ROS_MASTER_URI"
        )
    ros.init_node(f"rcmservo_{uuid.uuid4().hex[:12]}", disable_signals=True)
    return ros


@functools.cache
def made(kind: type[RosMessage]) -> Any:
    """rospy's class for messages of a kind."""
    dynamic: Any = import_module("genpy.dynamic")
    inner = "".join(f"{LINE}MSG: {ros}\n{parts}\n" for ros, parts in NESTED.items())
    text = f"std_msgs/Header header\n{kind.parts}\n{HEADER}{inner}"
    return dynamic.generate_dynamic(kind.ros, text)[kind.ros]


class Ros1:
    """Topics of this process' node."""

    def __init__(self) -> None:
        self._ros = rospy()
        self._writers: dict[str, Any] = {}
        self._readers: list[Any] = []

    def publish(self, topic: Topic[Said], message: Said) -> bool:
        out: Any = made(topic.kind)()
        out.header.stamp = self._ros.Time(*divmod(message.stamp, SECOND))
        for form, name in parts_of(topic.kind):
            _fill(out, form, name, getattr(message, name))
        try:
            self._writer(topic).publish(out)
        except self._ros.ROSException:
            return False
        return True

    def offer(self, topic: Topic[Any]) -> None:
        self._writer(topic)

    def listeners(self, topic: Topic[Any]) -> int:
        return self._writer(topic).get_num_connections()

    def subscribe(self, topic: Topic[Said], heard: Heard[Said]) -> None:
        own: str = self._ros.get_name()

        def take(came: Any) -> None:
            writer: str = came._connection_header["callerid"]
            if writer != own:
                heard(_told(topic.kind, came), writer)

        reader = self._ros.Subscriber(
            f"/{topic.name}", made(topic.kind), take, queue_size=DEPTH, tcp_nodelay=True
        )
        self._readers.append(reader)

    def close(self) -> None:
        with contextlib.suppress(self._ros.ROSException):
            for one in (*self._readers, *self._writers.values()):
                one.unregister()

    def _writer(self, topic: Topic[Any]) -> Any:
        if topic.name not in self._writers:
            try:
                self._writers[topic.name] = self._ros.Publisher(
                    f"/{topic.name}",
                    made(topic.kind),
                    queue_size=DEPTH,
                    latch=topic.latched,
                    tcp_nodelay=True,
                )
            except self._ros.ROSException as error:
                raise NoTransport(f"{topic.name} cannot be offered: {one_line(error)}") from error
        return self._writers[topic.name]


def _told(kind: type[Said], came: Any) -> Said:
    """A message of rospy's as plain data."""
    values = {name: _plain(form, getattr(came, name)) for form, name in parts_of(kind)}
    build: Any = kind
    return build(stamp=came.header.stamp.to_nsec(), **values)


def _plain(form: str, came: Any) -> Any:
    if form in NESTED:
        return tuple(_plain(part, getattr(came, name)) for part, name in lines_of(NESTED[form]))
    return tuple(came) if form in SEQUENCES else came


def _fill(out: Any, form: str, name: str, value: Any) -> None:
    if form not in NESTED:
        setattr(out, name, value)
        return
    for (part, inner), one in zip(lines_of(NESTED[form]), value, strict=True):
        _fill(getattr(out, name), part, inner, one)
