"""Codec of ROS 2 messages: CDR (common data representation) version 1, by `rosbags`."""

from collections.abc import Mapping
from typing import Any

from rcmservo.errors import RcmServoError

NS_PER_S = 10**9
MIN_INT32, MAX_INT32 = -(2**31), 2**31 - 1


class MalformedMessage(RcmServoError, ValueError):
    """Error of bytes that are no message of the expected type."""


class MessageCodec:
    """Encoder and decoder of a set of message types.

    Parameters
    ----------
    definitions : Mapping of str to str
        Definition of each type in the ROS 2 format, by type name such as std_msgs/msg/String.
    """

    def __init__(self, definitions: Mapping[str, str]) -> None:
        # this import takes 0.07 s, so it happens with the first message
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        types: dict[str, Any] = {}
        for message_type, definition in definitions.items():
            types.update(get_types_from_msg(definition, message_type))
        self._store: Any = get_typestore(Stores.EMPTY)
        self._store.register(types)
        self._malformed: type[Exception] = SerdeError

    def warm_up(self) -> None:
        """Generate the encoding and decoding code of all types."""
        for message_type in self._store.types:
            self._store.get_msgdef(message_type)

    def make(self, message_type: str, *fields: Any) -> Any:
        """Return a message, or a part of one, with these fields."""
        return self._store.types[message_type](*fields)

    def make_header(self, time: int, frame: str = "") -> Any:
        """Return a std_msgs/Header of a coordinate frame, with a stamp of `time` ns.

        The seconds of the stamp are clipped to the range of its 32 bits.
        """
        seconds, nanoseconds = divmod(time, NS_PER_S)
        clipped_seconds = min(max(seconds, MIN_INT32), MAX_INT32)
        stamp = self.make("builtin_interfaces/msg/Time", clipped_seconds, nanoseconds)
        return self.make("std_msgs/msg/Header", stamp, frame)

    def encode(self, message_type: str, *fields: Any) -> bytes:
        """Return a message with these fields as little endian bytes.

        Raises
        ------
        ValueError
            If an array of fixed size has another size.
        """
        message = self.make(message_type, *fields)
        try:
            return bytes(self._store.serialize_cdr(message, message_type, little_endian=True))
        except self._malformed as error:
            raise ValueError(f"{message_type}: {error}") from error

    def decode(self, message_type: str, data: bytes) -> Any:
        """Return the message that the bytes encode; its fields are attributes.

        Raises
        ------
        MalformedMessage
            If the bytes are no message of this type.
        """
        try:
            return self._store.deserialize_cdr(data, message_type)
        except self._malformed as error:
            raise MalformedMessage(f"{message_type}: {error}") from error


def read_stamp(header: Any) -> int:
    """Return the stamp of a header in ns."""
    return header.stamp.sec * NS_PER_S + header.stamp.nanosec
