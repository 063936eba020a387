"""ROS 2 without ROS: the topics of its nodes are topics of DDS, which Eclipse Cyclone DDS speaks.

A topic `PSM1/measured_js` is rt/PSM1/measured_js there, and sensor_msgs/JointState the type
sensor_msgs::msg::dds_::JointState_. Bytes are made here and handed to Cyclone's own lower layer:
its public way takes 0.1 s for a picture. By default it speaks on the loopback interface alone.

A reader that asks for what was said before hears nothing of a writer that keeps nothing; so a
latched topic has two readers.
"""

import contextlib
import dataclasses
import functools
import threading
from importlib import import_module
from typing import Any

from rcmservo.errors import NotInstalled, one_line
from rcmservo.hardware.crtk.cdr import packed, unpacked
from rcmservo.hardware.crtk.messages import (
    NESTED,
    RosMessage,
    Said,
    Topic,
    lines_of,
    parts_of,
)
from rcmservo.hardware.crtk.transport import Heard, NoTransport
from rcmservo.record.cdr import MalformedMessage

MODULES = "core", "domain", "idl.annotations", "idl.types", "pub", "qos", "sub", "topic", "_clayer"
DEPTH = 10
"""Messages that wait for a reader."""
LONGEST_WRITE = 1_000_000
"""ns after which a message that cannot be sent is given up."""
LOOK = 20_000_000
"""ns after which a reader that was added is waited for too."""
CONFIGURATION = """
<CycloneDDS><Domain id="any">
  <General><Interfaces><NetworkInterface name="{interface}"/></Interfaces></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex>{peers}</Discovery>
  <Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>
</Domain></CycloneDDS>"""
"""Type information of other vendors is not looked at: some of it Cyclone rejects without a word."""
LOCAL = (
    '<Peers><Peer address="127.0.0.1"/></Peers>'
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
)
"""On the loopback interface nobody is found by multicast."""


def dds() -> Any:
    """Cyclone DDS."""
    try:
        for part in MODULES:
            import_module(f"cyclonedds.{part}")
        return import_module("cyclonedds")
    except ImportError as error:
        raise NoTransport(str(NotInstalled("ROS 2", "cyclonedds", "ros2"))) from error


@functools.cache
def _domain(number: int) -> list[tuple[str, Any]]:
    """The domain with its interface, once for this process; empty before."""
    return []


class Ros2:
    """A participant of a domain, which hears in a thread of its own."""

    def __init__(self, domain: int = 0, interface: str = "lo") -> None:
        self._dds = dds()
        try:
            self._join(domain, interface)
            self._participant = self._dds.domain.DomainParticipant(domain)
            self._waiting: Any = self._dds.core.WaitSet(self._participant)
        except self._dds.core.DDSException as error:
            words = f"ROS 2 cannot be spoken on {interface}, domain {domain}: {one_line(error)}"
            raise NoTransport(words) from error
        self._lock, self._over = threading.Lock(), threading.Event()
        self._writers: dict[str, Any] = {}
        self._readers: list[tuple[Any, Any, type[Any], Heard[Any]]] = []
        self._topics: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._run, name="ros2", daemon=True)
        self._thread.start()

    def publish(self, topic: Topic[Said], message: Said) -> bool:
        writer = self._writer(topic)
        return self._dds._clayer.ddspy_write(writer._ref, packed(message)) >= 0

    def offer(self, topic: Topic[Any]) -> None:
        self._writer(topic)

    def listeners(self, topic: Topic[Any]) -> int:
        return len(self._writer(topic).get_matched_subscriptions())

    def subscribe(self, topic: Topic[Said], heard: Heard[Said]) -> None:
        for latched in {False, topic.latched}:
            reader = self._dds.sub.DataReader(
                self._participant,
                self._topic(topic),
                qos=self._quality(dataclasses.replace(topic, latched=latched), reading=True),
            )
            core = self._dds.core
            every = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
            condition = core.ReadCondition(reader, every)
            with self._lock:
                self._readers.append((reader, condition, topic.kind, heard))
                self._waiting.attach(condition)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        with self._lock:
            for _, condition, _, _ in self._readers:
                self._waiting.detach(condition)
            self._readers.clear()
            self._writers.clear()
            self._topics.clear()
        del self._waiting, self._participant

    def _join(self, number: int, interface: str) -> None:
        known = _domain(number)
        if not known:
            peers = LOCAL if interface == "lo" else ""
            text = CONFIGURATION.format(interface=interface, peers=peers)
            known.append((interface, self._dds.domain.Domain(number, text)))
        if known[0][0] != interface:
            words = f"domain {number} is on {known[0][0]} in this process already"
            raise NoTransport(f"ROS 2 cannot be spoken on {interface}: {words}")

    def _writer(self, topic: Topic[Any]) -> Any:
        with self._lock:
            if topic.name not in self._writers:
                quality = self._quality(topic, reading=False)
                self._writers[topic.name] = self._dds.pub.DataWriter(
                    self._participant, self._topic(topic), qos=quality
                )
            return self._writers[topic.name]

    def _topic(self, topic: Topic[Any]) -> Any:
        if topic.name not in self._topics:
            form = shape(self._dds, topic.kind)
            self._topics[topic.name] = self._dds.topic.Topic(
                self._participant, f"rt/{topic.name}", form
            )
        return self._topics[topic.name]

    def _quality(self, topic: Topic[Any], reading: bool) -> Any:
        policy = self._dds.qos.Policy
        sure = policy.Reliability.Reliable(LONGEST_WRITE)
        kept = policy.Durability.TransientLocal if topic.latched else policy.Durability.Volatile
        parts = [
            policy.Reliability.BestEffort if topic.lossy else sure,
            kept,
            policy.History.KeepLast(DEPTH),
            policy.DataRepresentation(use_cdrv0_representation=True),
        ]
        if reading:
            parts.append(policy.IgnoreLocal.Participant)
        return self._dds.qos.Qos(*parts)

    def _run(self) -> None:
        while not self._over.is_set():
            self._waiting.wait(LOOK)
            with self._lock:
                readers = list(self._readers)
            for reader, _, kind, heard in readers:
                self._take(reader, kind, heard)

    def _take(self, reader: Any, kind: type[RosMessage], heard: Heard[Any]) -> None:
        core = self._dds.core
        every = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
        taken: Any = self._dds._clayer.ddspy_take(reader._ref, every, DEPTH)
        if isinstance(taken, int):
            return
        for data, info in taken:
            if info.valid_data:
                with contextlib.suppress(MalformedMessage):
                    heard(unpacked(kind, data), f"{info.publication_handle:x}")


def shape(dds: Any, kind: type[RosMessage]) -> Any:
    """The type of a topic's messages, as Cyclone wants it described."""
    types = dds.idl.types

    def described(form: str) -> Any:
        if form in NESTED:
            return struct(form, **{name: described(part) for part, name in lines_of(NESTED[form])})
        name = form.removesuffix("[]")
        base = {"string": str, "bool": bool}.get(name) or getattr(types, name)
        return types.sequence[base] if form.endswith("[]") else base

    def struct(ros: str, /, **parts: Any) -> Any:
        package, name = ros.split("/")
        whole = f"{package}.msg.dds_.{name}_"
        return dds.idl.annotations.final(dds.idl.make_idl_struct(f"{name}_", whole, parts))

    time = struct("builtin_interfaces/Time", sec=types.int32, nanosec=types.uint32)
    header = struct("std_msgs/Header", stamp=time, frame_id=str)
    parts = {name: described(form) for form, name in parts_of(kind)}
    return struct(kind.ros, **{"header": header, **parts})
