"""ROS 2 messages as bytes: CDR (common data representation, version 1), by `rosbags`."""

from collections.abc import Mapping
from typing import Any

from rcmservo.errors import RcmServoError


class MalformedMessage(RcmServoError, ValueError):
    """Bytes that are no message of their type."""


class MessageCodec:
    """Encoder and decoder of some types of messages.

    Parameters
    ----------
    definitions : Mapping of str to str
        Definition of each type as ROS 2 writes it, by the type's name, such as std_msgs/msg/String.
    """

    def __init__(self, definitions: Mapping[str, str]) -> None:
        # takes 0.07 s, so it waits for the first message
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        types: dict[str, Any] = {}
        for kind, definition in definitions.items():
            types.update(get_types_from_msg(definition, kind))
        self._store: Any = get_typestore(Stores.EMPTY)
        self._store.register(types)
        self._malformed: type[Exception] = SerdeError

    def warm_up(self) -> None:
        """Generate the code of all types."""
        for kind in self._store.types:
            self._store.get_msgdef(kind)

    def make(self, kind: str, *fields: Any) -> Any:
        """Return a message, or a part of one, with these fields."""
        return self._store.types[kind](*fields)

    def header(self, time: int, frame: str = "") -> Any:
        """Return a std_msgs/Header with a stamp of `time` ns: at the end of its range if the time
        is beyond that."""
        sec, nanosec = divmod(time, 10**9)
        stamp = min(max(sec, -(2**31)), 2**31 - 1), nanosec
        moment = self.make("builtin_interfaces/msg/Time", *stamp)
        return self.make("std_msgs/msg/Header", moment, frame)

    def encode(self, kind: str, *fields: Any) -> bytes:
        """Return a message with these fields as bytes, little endian.

        Raises
        ------
        ValueError
            If an array of fixed size has another.
        """
        message = self.make(kind, *fields)
        try:
            return bytes(self._store.serialize_cdr(message, kind, little_endian=True))
        except self._malformed as error:
            raise ValueError(f"{kind}: {error}") from error

    def decode(self, kind: str, data: bytes) -> Any:
        """Return the message in some bytes, whose parts are its attributes.

        Raises
        ------
        MalformedMessage
            If the bytes are no such message.
        """
        try:
            return self._store.deserialize_cdr(data, kind)
        except self._malformed as error:
            raise MalformedMessage(f"{kind}: {error}") from error


def time_of(header: Any) -> int:
    """Return the stamp of a header in ns."""
    return header.stamp.sec * 10**9 + header.stamp.nanosec
