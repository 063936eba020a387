"""Encoding of CRTK messages as CDR bytes for DDS, with the codec of recordings.

DDS is the middleware of ROS 2, and CDR (common data representation) its binary format.
"""

from functools import cache
from typing import Any

import numpy as np

from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.messages import MessageT, RosMessage
from rcmservo.recording.cdr import MessageCodec, read_stamp
from rcmservo.recording.ros2_messages import HEADER_DEFINITIONS

ALIGNMENT_BYTES = 4
"""Cyclone pads messages to a multiple of this size."""


def encode_message(message: RosMessage) -> bytes:
    """Encode a message."""
    kind = type(message)
    codec = _codec(kind)
    values = [
        _to_codec_value(codec, field_type, getattr(message, name))
        for field_type, name in messages.message_fields(kind)
    ]
    data = codec.encode(_ros2_name(kind.ros_type), codec.make_header(message.stamp), *values)
    return data + bytes(-len(data) % ALIGNMENT_BYTES)


def decode_message(kind: type[MessageT], data: bytes) -> MessageT:
    """Decode a message, or raise `MalformedMessage`."""
    decoded = _codec(kind).decode(_ros2_name(kind.ros_type), data)
    return messages.read_message(kind, read_stamp(decoded.header), decoded)


@cache
def _codec(kind: type[RosMessage]) -> MessageCodec:
    """Return the codec of one message type."""
    definition = messages.complete_definition(kind, HEADER_DEFINITIONS)
    return MessageCodec({_ros2_name(kind.ros_type): definition})


def _ros2_name(ros_type: str) -> str:
    return ros_type.replace("/", "/msg/")


def _to_codec_value(codec: MessageCodec, field_type: str, value: Any) -> Any:
    """Convert the value of a field to the arrays and objects that the codec encodes."""
    if field_type in messages.NESTED_TYPES:
        inner_types = [kind for kind, _ in messages.parse_fields(messages.NESTED_TYPES[field_type])]
        pairs = zip(inner_types, value, strict=True)
        inner_values = [_to_codec_value(codec, inner_type, inner) for inner_type, inner in pairs]
        return codec.make(_ros2_name(field_type), *inner_values)
    if field_type == "uint8[]":
        return np.frombuffer(value, np.uint8)
    return np.array(value, np.float64) if field_type == "float64[]" else value
