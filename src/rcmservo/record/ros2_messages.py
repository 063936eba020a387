"""Messages of a record: topics, ROS 2 definitions, and their bytes in CDR.

A tick has numbers of fixed size first and names last, so that every number lies at a fixed place.
Ticks are read as columns by `numpy`, with one layout for all: to decode each by itself takes sixty
times as long (40 us in place of 0.6). A header's stamp is a moment on the plant's clock.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.guard.states import Mode, Phase
from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick
from rcmservo.record.cdr import MessageCodec, time_of
from rcmservo.record.columns import FLAGS, INTEGERS, LATER, REALS, TRUTH, WORDS, Column

CRTK = {phase: phase.name for phase in (Phase.DISABLED, Phase.PAUSED, Phase.FAULT)}
"""CRTK's name of a phase; all others are ENABLED."""
BUSY = Phase.ACQUIRE, Phase.SERVO, Phase.JOG
"""Phases in which the arm moves."""
NO_NUMBERS = np.empty(0)

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
"""Start of a message whose numbers are little endian."""

NAMES = "rcmservo_msgs/msg/Names"
"""Type of the names at the end of a tick, as a message of their own."""


@cache
def codec() -> MessageCodec:
    """Return the codec of a record's messages."""
    names = "".join(f"string {column.name}\n" for column in WORDS)
    return MessageCodec(DEFINITIONS | {NAMES: names})


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


def encode_tick(tick: Tick) -> bytes:
    """Encode one tick of the loop; its stamp is the moment of the observation."""
    integers = (column.of(tick) for column in INTEGERS)
    reals = (np.asarray(column.of(tick), np.float64).ravel() for column in REALS)
    flags, names = (column.of(tick) for column in FLAGS), (column.of(tick) for column in WORDS)
    stamped = codec().header(tick.seen.now)
    return codec().encode("rcmservo_msgs/msg/Tick", stamped, *integers, *reals, *flags, *names)


def decode_names(data: bytes, layout: np.dtype[Any]) -> tuple[str, ...]:
    """Return the names at the end of a tick whose numbers have a layout of `TICKS`."""
    place = layout.itemsize + -layout.itemsize % 4
    names = codec().decode(NAMES, ENCAPSULATION + data[place:])
    return tuple(getattr(names, column.name) for column in WORDS)


def encode_text(words: str) -> bytes:
    """Encode a std_msgs/String."""
    return codec().encode("std_msgs/msg/String", words)


def decode_text(data: bytes) -> str:
    """Return the words of a std_msgs/String."""
    return codec().decode("std_msgs/msg/String", data).data


def encode_operating_state(now: int, mode: Mode) -> bytes:
    """Encode CRTK's operating state: whether the drive is on, and below that phase, cause and way
    out in words."""
    state, busy = CRTK.get(mode.phase, "ENABLED"), mode.phase in BUSY
    stamped = codec().header(now)
    return codec().encode("crtk_msgs/msg/OperatingState", stamped, state, mode.words, True, busy)


def decode_operating_words(data: bytes) -> str:
    """Return the words of an operating state."""
    return codec().decode("crtk_msgs/msg/OperatingState", data).substate


def encode_truth(now: int, p1: Floats, p2: Floats, jacobian_error: float) -> bytes:
    """Encode what a simulation knows at a tick."""
    numbers = p1, p2, np.array([jacobian_error])
    return codec().encode("rcmservo_msgs/msg/Truth", codec().header(now), *numbers)


EMPTY_MEMORY = 24
"""Bytes of a memory of no numbers: encapsulation, header, and their count."""


def encode_memory(now: int, numbers: Floats) -> bytes:
    """Encode what a user's own estimator remembers (n,) at a tick."""
    return codec().encode("rcmservo_msgs/msg/Memory", codec().header(now), numbers)


def decode_memory(data: bytes) -> Floats:
    """Return the numbers (n,) of a memory.

    Earlier records align them to eight bytes even where there are none.
    """
    if data[EMPTY_MEMORY - 4 :] == bytes(8):
        data = data[:EMPTY_MEMORY]
    return codec().decode("rcmservo_msgs/msg/Memory", data).numbers


def encode_positions(names: Sequence[str], time: int, q: Floats) -> bytes:
    """Encode joints q (3,) measured at `time` ns as sensor_msgs/JointState."""
    return _joint_state(names, time, _in_metres(q), NO_NUMBERS)


def encode_rates(names: Sequence[str], time: int, rates: Floats) -> bytes:
    """Encode joint rates (3,) commanded at `time` ns as sensor_msgs/JointState."""
    return _joint_state(names, time, NO_NUMBERS, _in_metres(rates))


def _joint_state(names: Sequence[str], time: int, positions: Floats, rates: Floats) -> bytes:
    parts = codec().header(time), names, positions, rates, NO_NUMBERS
    return codec().encode("sensor_msgs/msg/JointState", *parts)


def _in_metres(values: Floats) -> Floats:
    """Joints or rates in SI units; empty where not all are finite, as JointState has no other way
    to say so."""
    return values * METRES if np.isfinite(values).all() else NO_NUMBERS


def encode_picture(exposure: int, data: bytes) -> bytes:
    """Encode a JPEG file's bytes, exposed at `exposure` ns, as sensor_msgs/CompressedImage."""
    stamped, pixels = codec().header(exposure, "camera"), np.frombuffer(data, np.uint8)
    return codec().encode("sensor_msgs/msg/CompressedImage", stamped, "jpeg", pixels)


def decode_picture(data: bytes) -> tuple[int, bytes]:
    """Return exposure ns and the JPEG file's bytes of what `encode_picture` made."""
    message = codec().decode("sensor_msgs/msg/CompressedImage", data)
    return time_of(message.header), message.data.tobytes()


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
