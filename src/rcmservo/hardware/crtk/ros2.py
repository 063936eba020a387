"""ROS 2 transport of CRTK messages over Eclipse Cyclone DDS, without an installation of ROS.

DDS is the middleware of ROS 2. A ROS 2 topic is a DDS topic with another name: `PSM1/measured_js`
is rt/PSM1/measured_js, and the type of sensor_msgs/JointState is
sensor_msgs::msg::dds_::JointState_. This module encodes messages and passes the bytes to Cyclone's
lower layer, because its public interface takes 0.1 s for an image. By default only the loopback
interface is used.

A transient-local reader does not match a volatile writer, so a latched topic has two readers.
"""

import contextlib
import dataclasses
import threading
from importlib import import_module
from typing import Any

from rcmservo.errors import NotInstalled, shorten_to_line
from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.cdr import decode_message, encode_message
from rcmservo.hardware.crtk.messages import MessageHandler, MessageT, NoTransport, RosMessage, Topic
from rcmservo.recording.cdr import MalformedMessage

MODULES = "core", "domain", "idl.annotations", "idl.types", "pub", "qos", "sub", "topic", "_clayer"
"""Modules of Cyclone that this module uses."""
HISTORY_DEPTH = 10
"""Messages that wait for a reader."""
WRITE_TIMEOUT_NS = 1_000_000
"""Time after which an unsent message is dropped."""
WAIT_PERIOD_NS = 20_000_000
"""Period at which the receiving thread includes new readers."""
CONFIGURATION = """
<CycloneDDS><Domain id="any">
  <General><Interfaces><NetworkInterface name="{interface}"/></Interfaces></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex>{peers}</Discovery>
  <Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>
</Domain></CycloneDDS>"""
"""Configuration of Cyclone. It ignores type information, because Cyclone silently rejects that of
some other vendors."""
LOOPBACK_PEERS = (
    '<Peers><Peer address="127.0.0.1"/></Peers>'
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
)
"""Peers on the loopback interface, which has no multicast discovery."""
_domains: dict[int, tuple[str, Any]] = {}
"""Interface and DDS domain of this process, by the number of the domain."""


def import_cyclone() -> Any:
    """Import Cyclone DDS, or raise `NoTransport`."""
    try:
        for name in MODULES:
            import_module(f"cyclonedds.{name}")
        return import_module("cyclonedds")
    except ImportError as error:
        raise NoTransport(str(NotInstalled("ROS 2", "cyclonedds", "ros2"))) from error


class Ros2:
    """Participant of a DDS domain, with a thread that receives.

    Parameters
    ----------
    domain : int
        Number of the domain.
    interface : str
        Network interface, the same for all participants of a domain in this process.

    Raises
    ------
    NoTransport
        If Cyclone DDS is not installed, or the interface cannot be used.
    """

    def __init__(self, domain: int = 0, interface: str = "lo") -> None:
        self._dds = import_cyclone()
        try:
            self._join(domain, interface)
            self._participant = self._dds.domain.DomainParticipant(domain)
            self._wait_set: Any = self._dds.core.WaitSet(self._participant)
        except self._dds.core.DDSException as error:
            text = f"ROS 2 cannot use {interface}, domain {domain}: {shorten_to_line(error)}"
            raise NoTransport(text) from error
        states = self._dds.core
        self._any_state = states.SampleState.Any | states.ViewState.Any | states.InstanceState.Any
        self._lock, self._closing = threading.Lock(), threading.Event()
        self._writers: dict[str, Any] = {}
        self._readers: list[tuple[Any, Any, type[Any], MessageHandler[Any]]] = []
        self._topics: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._run, name="ros2", daemon=True)
        self._thread.start()

    def publish(self, topic: Topic[MessageT], message: MessageT) -> bool:
        writer = self._writer(topic)
        return self._dds._clayer.ddspy_write(writer._ref, encode_message(message)) >= 0

    def offer(self, topic: Topic[Any]) -> None:
        self._writer(topic)

    def count_listeners(self, topic: Topic[Any]) -> int:
        return len(self._writer(topic).get_matched_subscriptions())

    def subscribe(self, topic: Topic[MessageT], handler: MessageHandler[MessageT]) -> None:
        for latched in {False, topic.latched}:
            qos = self._build_qos(dataclasses.replace(topic, latched=latched), reading=True)
            dds_topic = self._dds_topic(topic)
            reader = self._dds.sub.DataReader(self._participant, dds_topic, qos=qos)
            condition = self._dds.core.ReadCondition(reader, self._any_state)
            with self._lock:
                self._readers.append((reader, condition, topic.kind, handler))
                self._wait_set.attach(condition)

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        with self._lock:
            for _, condition, _, _ in self._readers:
                self._wait_set.detach(condition)
            self._readers.clear()
            self._writers.clear()
            self._topics.clear()
        del self._wait_set, self._participant

    def _join(self, number: int, interface: str) -> None:
        """Create the domain on an interface, or require that it exists there."""
        if number not in _domains:
            peers = LOOPBACK_PEERS if interface == "lo" else ""
            configuration = CONFIGURATION.format(interface=interface, peers=peers)
            _domains[number] = interface, self._dds.domain.Domain(number, configuration)
        used, _ = _domains[number]
        if used != interface:
            raise NoTransport(f"ROS 2 cannot use {interface}: domain {number} already uses {used}")

    def _writer(self, topic: Topic[Any]) -> Any:
        with self._lock:
            if topic.name not in self._writers:
                qos = self._build_qos(topic, reading=False)
                writer = self._dds.pub.DataWriter(
                    self._participant, self._dds_topic(topic), qos=qos
                )
                self._writers[topic.name] = writer
            return self._writers[topic.name]

    def _dds_topic(self, topic: Topic[Any]) -> Any:
        """Return the DDS topic of a ROS 2 topic, created on first use."""
        if topic.name not in self._topics:
            name, idl_type = f"rt/{topic.name}", describe_type(self._dds, topic.kind)
            self._topics[topic.name] = self._dds.topic.Topic(self._participant, name, idl_type)
        return self._topics[topic.name]

    def _build_qos(self, topic: Topic[Any], reading: bool) -> Any:
        """Build the quality of service of a reader or writer of a topic."""
        policy = self._dds.qos.Policy
        reliable = policy.Reliability.Reliable(WRITE_TIMEOUT_NS)
        durability = policy.Durability
        policies = [
            policy.Reliability.BestEffort if topic.lossy else reliable,
            durability.TransientLocal if topic.latched else durability.Volatile,
            policy.History.KeepLast(HISTORY_DEPTH),
            policy.DataRepresentation(use_cdrv0_representation=True),
        ]
        if reading:
            policies.append(policy.IgnoreLocal.Participant)
        return self._dds.qos.Qos(*policies)

    def _run(self) -> None:
        while not self._closing.is_set():
            self._wait_set.wait(WAIT_PERIOD_NS)
            with self._lock:
                readers = list(self._readers)
            for reader, _, kind, handler in readers:
                self._receive(reader, kind, handler)

    def _receive(self, reader: Any, kind: type[RosMessage], handler: MessageHandler[Any]) -> None:
        """Take the messages of a reader from Cyclone and pass them to the reader's handler."""
        samples: Any = self._dds._clayer.ddspy_take(reader._ref, self._any_state, HISTORY_DEPTH)
        if isinstance(samples, int):  # an error code
            return
        for data, info in samples:
            if info.valid_data:
                with contextlib.suppress(MalformedMessage):
                    handler(decode_message(kind, data), f"{info.publication_handle:x}")


def describe_type(dds: Any, kind: type[RosMessage]) -> Any:
    """Return Cyclone's description of a message type."""
    types = dds.idl.types

    def describe(field_type: str) -> Any:
        if field_type in messages.NESTED_TYPES:
            inner_fields = messages.parse_fields(messages.NESTED_TYPES[field_type])
            return build_struct(field_type, {name: describe(kind) for kind, name in inner_fields})
        name = field_type.removesuffix("[]")
        item_type = {"string": str, "bool": bool}.get(name) or getattr(types, name)
        return types.sequence[item_type] if field_type.endswith("[]") else item_type

    def build_struct(ros_type: str, fields: dict[str, Any]) -> Any:
        package, name = ros_type.split("/")
        full_name = f"{package}.msg.dds_.{name}_"
        return dds.idl.annotations.final(dds.idl.make_idl_struct(f"{name}_", full_name, fields))

    time_fields = {"sec": types.int32, "nanosec": types.uint32}
    time = build_struct("builtin_interfaces/Time", time_fields)
    header = build_struct("std_msgs/Header", {"stamp": time, "frame_id": str})
    fields = {name: describe(field_type) for field_type, name in messages.message_fields(kind)}
    return build_struct(kind.ros_type, {"header": header, **fields})
