"""Messages of CRTK as the bytes that DDS carries, by the codec that records use."""

from functools import cache
from typing import Any

import numpy as np

from rcmservo.hardware.crtk.messages import NESTED, RosMessage, Said, lines_of, parts_of
from rcmservo.record.cdr import MessageCodec, time_of
from rcmservo.record.ros2_messages import LINE, STAMPED

WORD = 4
"""Bytes to whose multiple Cyclone fills a message up."""


@cache
def _codec(kind: type[RosMessage]) -> MessageCodec:
    """Return the codec of one type of messages."""
    nested = "".join(f"{LINE}MSG: {name}\n{parts}\n" for name, parts in NESTED.items())
    return MessageCodec(
        {_name(kind.ros): f"std_msgs/Header header\n{kind.parts}\n{STAMPED}{nested}"}
    )


def _name(ros: str) -> str:
    """Return the name of a type in ROS 2."""
    return ros.replace("/", "/msg/")


def packed(message: RosMessage) -> bytes:
    """Return a message as bytes."""
    kind = type(message)
    codec = _codec(kind)
    parts = (_encodable(codec, form, getattr(message, name)) for form, name in parts_of(kind))
    data = codec.encode(_name(kind.ros), codec.header(message.stamp), *parts)
    return data + bytes(-len(data) % WORD)


def _encodable(codec: MessageCodec, form: str, value: Any) -> Any:
    """Return a value as the codec takes it."""
    if form in NESTED:
        parts = zip(lines_of(NESTED[form]), value, strict=True)
        return codec.make(_name(form), *(_encodable(codec, part, one) for (part, _), one in parts))
    if form == "uint8[]":
        return np.frombuffer(value, np.uint8)
    return np.array(value, np.float64) if form == "float64[]" else value


def unpacked(kind: type[Said], data: bytes) -> Said:
    """Return the message in some bytes; `MalformedMessage` if they are none."""
    message = _codec(kind).decode(_name(kind.ros), data)
    values = {name: _plain(form, getattr(message, name)) for form, name in parts_of(kind)}
    made: Any = kind
    return made(stamp=time_of(message.header), **values)


def _plain(form: str, value: Any) -> Any:
    """Return a value of the codec as plain data."""
    if form in NESTED:
        return tuple(_plain(part, getattr(value, name)) for part, name in lines_of(NESTED[form]))
    if form == "uint8[]":
        return value.tobytes()
    if form == "float64[]":
        return tuple(value.tolist())
    return tuple(value) if form == "string[]" else value
