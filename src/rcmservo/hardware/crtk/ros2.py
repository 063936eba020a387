"""ROS 2 transport over Eclipse Cyclone DDS, without an installation of ROS.

ROS 2 topics are DDS topics: `PSM1/measured_js` is rt/PSM1/measured_js, and the type of
sensor_msgs/JointState is sensor_msgs::msg::dds_::JointState_. This module encodes messages and
passes the bytes to Cyclone's lower layer, because its public interface takes 0.1 s for an image. By
default only the loopback interface is used.

A transient-local reader does not match a volatile writer, so a latched topic has two readers.
"""

import contextlib
import dataclasses
import functools
import threading
from importlib import import_module
from typing import Any

from rcmservo.errors import NotInstalled, one_line
from rcmservo.hardware.crtk.cdr import decode_message, encode_message
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
from rcmservo.recording.cdr import MalformedMessage

CYCLONE_MODULES = (
    "core",
    "domain",
    "idl.annotations",
    "idl.types",
    "pub",
    "qos",
    "sub",
    "topic",
    "_clayer",
)
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


def import_cyclone() -> Any:
    """Import Cyclone DDS, or raise `NoTransport`."""
    try:
        for part in CYCLONE_MODULES:
            import_module(f"cyclonedds.{part}")
        return import_module("cyclonedds")
    except ImportError as error:
        raise NoTransport(str(NotInstalled("ROS 2", "cyclonedds", "ros2"))) from error


@functools.cache
def _domain(number: int) -> list[tuple[str, Any]]:
    """Return the process-wide list with interface and DDS domain, empty before the first use."""
    return []


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
            text = f"ROS 2 cannot use {interface}, domain {domain}: {one_line(error)}"
            raise NoTransport(text) from error
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

    def listeners(self, topic: Topic[Any]) -> int:
        return len(self._writer(topic).get_matched_subscriptions())

    def subscribe(self, topic: Topic[MessageT], handler: MessageHandler[MessageT]) -> None:
        for latched in {False, topic.latched}:
            reader = self._dds.sub.DataReader(
                self._participant,
                self._topic(topic),
                qos=self._qos(dataclasses.replace(topic, latched=latched), reading=True),
            )
            core = self._dds.core
            every = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
            condition = core.ReadCondition(reader, every)
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
        known = _domain(number)
        if not known:
            peers = LOOPBACK_PEERS if interface == "lo" else ""
            text = CONFIGURATION.format(interface=interface, peers=peers)
            known.append((interface, self._dds.domain.Domain(number, text)))
        if known[0][0] != interface:
            used = known[0][0]
            raise NoTransport(f"ROS 2 cannot use {interface}: domain {number} already uses {used}")

    def _writer(self, topic: Topic[Any]) -> Any:
        with self._lock:
            if topic.name not in self._writers:
                qos = self._qos(topic, reading=False)
                self._writers[topic.name] = self._dds.pub.DataWriter(
                    self._participant, self._topic(topic), qos=qos
                )
            return self._writers[topic.name]

    def _topic(self, topic: Topic[Any]) -> Any:
        if topic.name not in self._topics:
            idl_type = describe_type(self._dds, topic.kind)
            self._topics[topic.name] = self._dds.topic.Topic(
                self._participant, f"rt/{topic.name}", idl_type
            )
        return self._topics[topic.name]

    def _qos(self, topic: Topic[Any], reading: bool) -> Any:
        policy = self._dds.qos.Policy
        reliable = policy.Reliability.Reliable(WRITE_TIMEOUT_NS)
        durability = (
            policy.Durability.TransientLocal if topic.latched else policy.Durability.Volatile
        )
        policies = [
            policy.Reliability.BestEffort if topic.lossy else reliable,
            durability,
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
        core = self._dds.core
        every = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
        taken: Any = self._dds._clayer.ddspy_take(reader._ref, every, HISTORY_DEPTH)
        if isinstance(taken, int):
            return
        for data, info in taken:
            if info.valid_data:
                with contextlib.suppress(MalformedMessage):
                    handler(decode_message(kind, data), f"{info.publication_handle:x}")


def describe_type(dds: Any, kind: type[RosMessage]) -> Any:
    """Return Cyclone's description of a message type."""
    types = dds.idl.types

    def describe(field_type: str) -> Any:
        if field_type in NESTED_TYPES:
            inner = parse_fields(NESTED_TYPES[field_type])
            return struct(field_type, **{name: describe(one) for one, name in inner})
        name = field_type.removesuffix("[]")
        base = {"string": str, "bool": bool}.get(name) or getattr(types, name)
        return types.sequence[base] if field_type.endswith("[]") else base

    def struct(ros_type: str, /, **fields: Any) -> Any:
        package, name = ros_type.split("/")
        full_name = f"{package}.msg.dds_.{name}_"
        return dds.idl.annotations.final(dds.idl.make_idl_struct(f"{name}_", full_name, fields))

    time = struct("builtin_interfaces/Time", sec=types.int32, nanosec=types.uint32)
    header = struct("std_msgs/Header", stamp=time, frame_id=str)
    fields = {name: describe(field_type) for field_type, name in message_fields(kind)}
    return struct(kind.ros_type, **{"header": header, **fields})
