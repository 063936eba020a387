"""Messages as the bytes that DDS carries: CDR, the common data representation, version 1.

Four bytes say which order numbers are in. Every number stands at a multiple of its own size,
counted from behind them. Source: OMG DDS-RTPS, 10.2, and CORBA, 9.3.
"""

import struct
from typing import Any

from rcmservo.errors import RcmServoError
from rcmservo.hardware.crtk.messages import NESTED, RosMessage, Said, lines_of, parts_of

NUMBERS = {"bool": "?", "uint8": "B", "int32": "i", "uint32": "I", "float64": "d"}
HEADER = [("int32", "sec"), ("uint32", "nanosec"), ("string", "frame_id")]
SECOND = 1_000_000_000
LITTLE = b"\x00\x01\x00\x00"


class Malformed(RcmServoError):
    """Bytes that are no such message."""


def packed(message: RosMessage) -> bytes:
    """A message as bytes, whose count is a multiple of 4."""
    out = bytearray()
    for form, value in zip(("int32", "uint32"), divmod(message.stamp, SECOND), strict=True):
        _put(out, form, value)
    _put(out, "string", "")
    for form, name in parts_of(type(message)):
        _put(out, form, getattr(message, name))
    return LITTLE + bytes(out) + b"\x00" * (-len(out) % 4)


def _put(out: bytearray, form: str, value: Any) -> None:
    if form == "string":
        raw = value.encode() + b"\x00"
        _put(out, "uint32", len(raw))
        out += raw
    elif form in NESTED:
        for (part, _), one in zip(lines_of(NESTED[form]), value, strict=True):
            _put(out, part, one)
    elif form.endswith("[]"):
        _put(out, "uint32", len(value))
        if form == "uint8[]":
            out += value
        elif form == "string[]":
            for one in value:
                _put(out, "string", one)
        elif value:
            _aligned(out, 8)
            out += struct.pack(f"<{len(value)}d", *value)
    else:
        letter = NUMBERS[form]
        _aligned(out, struct.calcsize(letter))
        out += struct.pack("<" + letter, value)


def _aligned(out: bytearray, size: int) -> None:
    out += b"\x00" * (-len(out) % size)


def unpacked(kind: type[Said], data: bytes) -> Said:
    """The message in some bytes, or :class:`Malformed`."""
    reader = _Reader(data)
    try:
        sec, nanosec, _ = (reader.get(form) for form, _ in HEADER)
        values = {name: reader.get(form) for form, name in parts_of(kind)}
    except (struct.error, UnicodeDecodeError) as error:
        raise Malformed(f"{kind.ros}: {error}") from error
    made: Any = kind
    return made(stamp=sec * SECOND + nanosec, **values)


class _Reader:
    """Some bytes, read from the first to the last."""

    def __init__(self, data: bytes) -> None:
        if data[:2] not in (b"\x00\x00", b"\x00\x01"):
            raise Malformed(f"CDR must begin with 00 00 or 00 01, got {data[:2].hex(' ')}")
        self._order = "<" if data[1] else ">"
        self._data, self._at = memoryview(data)[4:], 0

    def get(self, form: str) -> Any:
        """The next value."""
        if form == "string":
            return bytes(self._take(self.get("uint32"))).rstrip(b"\x00").decode()
        if form in NESTED:
            return tuple(self.get(part) for part, _ in lines_of(NESTED[form]))
        if form.endswith("[]"):
            return self._several(form, self.get("uint32"))
        letter = NUMBERS[form]
        return self._numbers(letter, 1)[0]

    def _several(self, form: str, count: int) -> Any:
        if form == "uint8[]":
            return bytes(self._take(count))
        if form == "string[]":
            if count > len(self._data):
                raise Malformed(f"{count} strings in {len(self._data)} bytes")
            return tuple(self.get("string") for _ in range(count))
        return self._numbers("d", count) if count else ()

    def _numbers(self, letter: str, count: int) -> tuple[Any, ...]:
        size = struct.calcsize(letter)
        self._at += -self._at % size
        return struct.unpack(f"{self._order}{count}{letter}", self._take(size * count))

    def _take(self, count: int) -> memoryview:
        if count > len(self._data) - self._at:
            raise Malformed(f"{count} bytes are to come, and there are {len(self._data)} in all")
        self._at += count
        return self._data[self._at - count : self._at]
