"""Encoding of CRTK messages as CDR bytes for DDS, with the codec of recordings."""

from functools import cache
from typing import Any

import numpy as np

from rcmservo.hardware.crtk.messages import (
    NESTED_TYPES,
    MessageT,
    RosMessage,
    message_fields,
    parse_fields,
)
from rcmservo.recording.cdr import MessageCodec, time_of
from rcmservo.recording.ros2_messages import HEADER_DEFINITIONS, SEPARATOR_LINE

ALIGNMENT_BYTES = 4
"""Cyclone pads messages to a multiple of this size."""


@cache
def _codec(kind: type[RosMessage]) -> MessageCodec:
    """Return the codec of one message type."""
    nested = "".join(
        f"{SEPARATOR_LINE}MSG: {name}\n{definition}\n" for name, definition in NESTED_TYPES.items()
    )
    header = "std_msgs/Header header"
    return MessageCodec(
        {_ros2_name(kind.ros_type): f"{header}\n{kind.definition}\n{HEADER_DEFINITIONS}{nested}"}
    )


def _ros2_name(ros_type: str) -> str:
    return ros_type.replace("/", "/msg/")


def encode_message(message: RosMessage) -> bytes:
    """Encode a message."""
    kind = type(message)
    codec = _codec(kind)
    values = (
        _to_codec_value(codec, field_type, getattr(message, name))
        for field_type, name in message_fields(kind)
    )
    data = codec.encode(_ros2_name(kind.ros_type), codec.header(message.stamp), *values)
    return data + bytes(-len(data) % ALIGNMENT_BYTES)


def _to_codec_value(codec: MessageCodec, field_type: str, value: Any) -> Any:
    if field_type in NESTED_TYPES:
        fields = zip(parse_fields(NESTED_TYPES[field_type]), value, strict=True)
        values = (_to_codec_value(codec, inner, one) for (inner, _), one in fields)
        return codec.make(_ros2_name(field_type), *values)
    if field_type == "uint8[]":
        return np.frombuffer(value, np.uint8)
    return np.array(value, np.float64) if field_type == "float64[]" else value


def decode_message(kind: type[MessageT], data: bytes) -> MessageT:
    """Decode a message, or raise `MalformedMessage`."""
    decoded = _codec(kind).decode(_ros2_name(kind.ros_type), data)
    values = {
        name: _to_plain_value(field_type, getattr(decoded, name))
        for field_type, name in message_fields(kind)
    }
    create: Any = kind
    return create(stamp=time_of(decoded.header), **values)


def _to_plain_value(field_type: str, value: Any) -> Any:
    if field_type in NESTED_TYPES:
        fields = parse_fields(NESTED_TYPES[field_type])
        return tuple(_to_plain_value(inner, getattr(value, name)) for inner, name in fields)
    if field_type == "uint8[]":
        return value.tobytes()
    if field_type == "float64[]":
        return tuple(value.tolist())
    return tuple(value) if field_type == "string[]" else value
