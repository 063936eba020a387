"""How a run's messages lie in bytes: ROS 2's CDR encoding, little endian, and the message
definitions beside it.

A tick has numbers of fixed size first and words last, so that every number lies at a fixed place:
one is written in one go, and any number of them are read back as columns. A header's stamp is a
moment on the plant's clock.
"""

import struct
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.guard.states import Mode, Phase
from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick
from rcmservo.record.columns import FLAGS, INTEGERS, LATER, REALS, TRUTH, WORDS, Column

CRTK = {phase: phase.name for phase in (Phase.DISABLED, Phase.PAUSED, Phase.FAULT)}
"""CRTK's name of a phase; all others are ENABLED."""

METRES = np.array([1.0, 1.0, 1e-3])
"""One rad, rad, mm in SI units."""

TIME_DEFINITION = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
LINE = "=" * 80 + "\n"
STAMPED = (
    f"{LINE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring "
    f"frame_id\n{LINE}{TIME_DEFINITION}"
)


def _definition(*fields: str) -> str:
    return "\n".join(["std_msgs/Header header", *fields]) + "\n" + STAMPED


def _arrays(numbers: Mapping[str, tuple[str, ...]]) -> list[str]:
    return [f"float64[{len(parts)}] {name.lower()}" for name, parts in numbers.items()]


def _tick_definition(reals: Sequence[Column]) -> str:
    return _definition(
        *(f"int64 {column.name}" for column in INTEGERS),
        *_arrays({column.name: column.parts for column in reals}),
        *(f"bool {column.name}" for column in FLAGS),
        *(f"string {column.name}" for column in WORDS),
    )


def _without(names: Sequence[str]) -> list[Column]:
    return [column for column in REALS if column.name not in names]


VERSIONS = [_without([*chain(*LATER[held:])]) for held in range(len(LATER) + 1)]
"""The real numbers that a tick held in one version after the other."""

DEFINITIONS = {
    "std_msgs/msg/String": "string data\n",
    "sensor_msgs/msg/JointState": _definition(
        "string[] name", "float64[] position", "float64[] velocity", "float64[] effort"
    ),
    "crtk_msgs/msg/OperatingState": _definition(
        "string state", "string substate", "bool is_homed", "bool is_busy"
    ),
    "sensor_msgs/msg/CompressedImage": _definition("string format", "uint8[] data"),
    "rcmservo_msgs/msg/Truth": _definition(*_arrays(TRUTH)),
    "rcmservo_msgs/msg/Memory": _definition("float64[] numbers"),
    "rcmservo_msgs/msg/Tick": _tick_definition(REALS),
}
"""Every message's definition as ROS 2 writes it, by its type."""

TOPICS = {
    "rcmservo/about": "std_msgs/msg/String",
    "rcmservo/stage": "std_msgs/msg/String",
    "rcmservo/memory": "rcmservo_msgs/msg/Memory",
    "rcmservo/tick": "rcmservo_msgs/msg/Tick",
    "rcmservo/truth": "rcmservo_msgs/msg/Truth",
    "measured_js": "sensor_msgs/msg/JointState",
    "servo_jv": "sensor_msgs/msg/JointState",
    "operating_state": "crtk_msgs/msg/OperatingState",
    "image_raw/compressed": "sensor_msgs/msg/CompressedImage",
}
"""The type of every topic's messages."""

ENCAPSULATION = b"\x00\x01\x00\x00"
ANONYMOUS = struct.Struct("<4siII")
"""Encapsulation, stamp in s and ns, and the length of an empty frame_id, whose end and padding are
four zeros."""


def _numbers(columns: Sequence[Column], code: str) -> list[tuple[str, str, tuple[int]]]:
    return [(column.name, code, (len(column.parts),)) for column in columns]


START = [("start", "S4"), ("sec", "<i4"), ("nanosec", "<u4"), ("frame_id", "<u4"), ("end", "<u4")]


def _tick_layout(reals: Sequence[Column]) -> np.dtype[Any]:
    return np.dtype(
        [*START, *_numbers(INTEGERS, "<i8"), *_numbers(reals, "<f8"), *_numbers(FLAGS, "?")]
    )


TICK = _tick_layout(REALS)
"""A tick up to its words."""

TICKS = {_tick_definition(reals): _tick_layout(reals) for reals in VERSIONS}
"""The same as every version wrote it, by its definition."""

TRUTH_LAYOUT = np.dtype(
    [("start", "S20"), *((name, "<f8", (len(parts),)) for name, parts in TRUTH.items())]
)

_INTEGERS = struct.Struct(f"<I{len(INTEGERS)}q")
_FLAGS = struct.Struct(f"<{len(FLAGS)}?")
_BLOCK = 8 * sum(len(column.parts) for column in REALS)
_IMAGE = struct.Struct("<4siII8sI8sI")


def stamp(time: int) -> tuple[int, int]:
    """builtin_interfaces/Time of `time` ns: s and ns, at the end of its range where the time is
    beyond that."""
    sec, nanosec = divmod(time, 10**9)
    return min(max(sec, -(2**31)), 2**31 - 1), nanosec


def header(time: int) -> bytes:
    """The first 16 bytes of a message with a stamp of `time` ns and no frame_id."""
    return ANONYMOUS.pack(ENCAPSULATION, *stamp(time), 1)


def tick(tick: Tick) -> bytes:
    """One tick of the loop; its stamp is the moment of the observation."""
    whole = _INTEGERS.pack(0, *(column.of(tick) for column in INTEGERS))
    block = np.concatenate([np.ravel(column.of(tick)) for column in REALS]).tobytes()
    if len(block) != _BLOCK:
        raise ValueError("a tick's numbers have another shape than they should")
    flags = _FLAGS.pack(*(column.of(tick) for column in FLAGS))
    words = tuple(column.of(tick) for column in WORDS)
    return b"".join((header(tick.seen.now), whole, block, flags, _tail(words)))


_tails: dict[tuple[str, ...], bytes] = {}


def _tail(words: tuple[str, ...]) -> bytes:
    """The words as they follow a tick's numbers; a run has few different ones."""
    if words not in _tails:
        _tails[words] = strings(words, TICK.itemsize)
    return _tails[words]


def strings(words: Sequence[str], place: int) -> bytes:
    """Strings in CDR from the byte `place` on, counted with the encapsulation: each length lies on
    a multiple of 4."""
    data = bytearray()
    for word in words:
        data += bytes(-(place + len(data)) % 4)
        encoded = word.encode() + b"\0"
        data += struct.pack("<I", len(encoded)) + encoded
    return bytes(data)


def words_of(data: bytes, place: int, count: int) -> tuple[str, ...]:
    """The `count` strings that `strings` put there; ValueError where the bytes are no such
    strings."""
    words: list[str] = []
    for _ in range(count):
        place += -place % 4
        if place + 4 > len(data):
            raise ValueError("a string begins beyond the end of its message")
        (length,) = struct.unpack_from("<I", data, place)
        end = place + 4 + length
        if not 1 <= length <= len(data) - place - 4 or data[end - 1] != 0:
            raise ValueError("a string ends beyond the end of its message")
        words.append(data[place + 4 : end - 1].decode())
        place = end
    return tuple(words)


def text(words: str) -> bytes:
    """A std_msgs/String."""
    return ENCAPSULATION + strings([words], 4)


def operating_state(now: int, mode: Mode) -> bytes:
    """CRTK's operating state: whether the drive is on, and below that phase, cause and way out in
    words."""
    start = header(now) + bytes(4)
    busy = mode.phase in (Phase.ACQUIRE, Phase.SERVO, Phase.JOG)
    return (
        start
        + strings((CRTK.get(mode.phase, "ENABLED"), mode.words), len(start))
        + bytes((True, busy))
    )


def operating_words(data: bytes) -> str:
    """The words of an operating state."""
    return words_of(data, ANONYMOUS.size + 4, 2)[1]


def truth(now: int, p1: Floats, p2: Floats, jacobian_error: float) -> bytes:
    """What a simulation knows at a tick."""
    return header(now) + bytes(4) + np.array([*p1, *p2, jacobian_error]).tobytes()


class JointStates:
    """sensor_msgs/JointState of one mechanism's joints, in rad and m."""

    def __init__(self, names: Sequence[str]) -> None:
        start = struct.pack("<I", len(names)) + strings(names, 4)
        self._names = bytes(4) + start + bytes(-len(start) % 4)

    def positions(self, time: int, q: Floats) -> bytes:
        """The joints q (3,) measured at `time` ns."""
        return header(time) + self._names + self._sequence(len(self._names), q) + bytes(8)

    def rates(self, time: int, rates: Floats) -> bytes:
        """The joint rates (3,) commanded at `time` ns."""
        return (
            header(time)
            + self._names
            + bytes(4)
            + self._sequence(len(self._names) + 4, rates)
            + bytes(4)
        )

    @staticmethod
    def _sequence(place: int, values: Floats) -> bytes:
        """A float64[]; empty where not all values are finite, as JointState has no other way to say
        so."""
        if not np.isfinite(values).all():
            return bytes(4)
        padding = bytes(-(place + 12 + 4) % 8)
        return struct.pack("<I", 3) + padding + (values * METRES).tobytes()


def image(exposure: int, data: bytes) -> bytes:
    """A sensor_msgs/CompressedImage of a JPEG file's bytes, exposed at `exposure` ns."""
    return _image_start(exposure, len(data)) + data


def _image_start(exposure: int, size: int) -> bytes:
    return _IMAGE.pack(ENCAPSULATION, *stamp(exposure), 7, b"camera", 5, b"jpeg", size)


def image_of(data: bytes) -> tuple[int, bytes]:
    """Exposure ns and the JPEG file's bytes of what `image` made; ValueError where it is no such
    thing."""
    if len(data) < _IMAGE.size:
        raise ValueError("a picture's message is too short")
    _, sec, nanosec, *_ = _IMAGE.unpack_from(data)
    exposure, picture = sec * 10**9 + nanosec, data[_IMAGE.size :]
    if data[: _IMAGE.size] != _image_start(exposure, len(picture)):
        raise ValueError("a picture's message is laid out otherwise")
    return exposure, picture


def columns(layout: np.dtype[Any], rows: Sequence[bytes]) -> dict[str, NDArray[Any]]:
    """Messages of one layout as columns (N, size) by name; ValueError where one is too short."""
    size = layout.itemsize
    joined = b"".join([row[:size] for row in rows])
    if len(joined) != size * len(rows):
        raise ValueError("a message is too short")
    table = np.frombuffer(joined, layout)
    return {
        name: np.ascontiguousarray(table[name]) for name in layout.names or () if layout[name].shape
    }


def tick_columns(layout: np.dtype[Any], rows: Sequence[bytes]) -> dict[str, NDArray[Any]]:
    """Ticks of one of `TICKS` as columns; NaN in those that it does not hold."""
    found = columns(layout, rows)
    return {
        name: found.get(name, np.full((len(rows), *TICK[name].shape), np.nan))
        for name in TICK.names or ()
        if TICK[name].shape
    }
