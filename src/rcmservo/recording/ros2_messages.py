"""Messages of a record: topics, ROS 2 definitions, and encoding in CDR.

A tick holds numbers of fixed size first and names last, so each number has a fixed offset. `numpy`
reads all ticks as columns with one layout: decoding each tick separately takes sixty times as long
(40 us instead of 0.6 us). A header's stamp is a time on the plant's clock.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick
from rcmservo.recording.cdr import MessageCodec, time_of
from rcmservo.recording.tick_schema import (
    FLAG_COLUMNS,
    FORMER_NAMES,
    INTEGER_COLUMNS,
    LATER,
    NAME_COLUMNS,
    REAL_COLUMNS,
    TRUTH_COLUMNS,
    Column,
)
from rcmservo.safety.state_machine import Mode, Phase

CRTK_STATES = {phase: phase.name for phase in (Phase.DISABLED, Phase.PAUSED, Phase.FAULT)}
"""CRTK's name of a phase; all other phases are ENABLED."""
BUSY_PHASES = Phase.ACQUIRE, Phase.SERVO, Phase.JOG
"""Phases in which the arm moves."""
NO_VALUES = np.empty(0)
EMPTY: Mapping[str, str] = {}

SI_FACTORS = np.array([1.0, 1.0, 1e-3])
"""Factors from rad, rad, mm to SI units."""

TIME_DEFINITION = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
SEPARATOR_LINE = "=" * 80 + "\n"
HEADER_DEFINITIONS = (
    f"{SEPARATOR_LINE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring "
    f"frame_id\n{SEPARATOR_LINE}{TIME_DEFINITION}"
)


def _definition(*fields: str) -> str:
    return "\n".join(["std_msgs/Header header", *fields]) + "\n" + HEADER_DEFINITIONS


def _arrays(numbers: Mapping[str, tuple[str, ...]]) -> list[str]:
    return [f"float64[{len(parts)}] {name.lower()}" for name, parts in numbers.items()]


def _tick_definition(reals: Sequence[Column], names: Mapping[str, str] = EMPTY) -> str:
    """Return the definition of a tick; `names` replace the present names of columns."""

    def named(columns: Sequence[Column]) -> dict[str, tuple[str, ...]]:
        return {names.get(column.name, column.name): column.parts for column in columns}

    return _definition(
        *(f"int64 {name}" for name in named(INTEGER_COLUMNS)),
        *_arrays(named(reals)),
        *(f"bool {name}" for name in named(FLAG_COLUMNS)),
        *(f"string {name}" for name in named(NAME_COLUMNS)),
    )


def _without(names: Sequence[str]) -> list[Column]:
    return [column for column in REAL_COLUMNS if column.name not in names]


REALS_BY_VERSION = [_without([*chain(*LATER[version:])]) for version in range(len(LATER) + 1)]
"""Real numbers of a tick in each version of the format."""

DEFINITIONS = {
    "std_msgs/msg/String": "string data\n",
    "sensor_msgs/msg/JointState": _definition(
        "string[] name", "float64[] position", "float64[] velocity", "float64[] effort"
    ),
    "crtk_msgs/msg/OperatingState": _definition(
        "string state", "string substate", "bool is_homed", "bool is_busy"
    ),
    "sensor_msgs/msg/CompressedImage": _definition("string format", "uint8[] data"),
    "rcmservo_msgs/msg/Truth": _definition(*_arrays(TRUTH_COLUMNS)),
    "rcmservo_msgs/msg/Memory": _definition("float64[] numbers"),
    "rcmservo_msgs/msg/Tick": _tick_definition(REAL_COLUMNS),
}
"""Definition of each message type in the ROS 2 format."""

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
"""Message type of each topic."""

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Start of a message with little endian numbers."""

TICK_NAMES = "rcmservo_msgs/msg/Names"
"""Message type of the names at the end of a tick."""


@cache
def codec() -> MessageCodec:
    """Return the codec of all message types of a record."""
    names = "".join(f"string {column.name}\n" for column in NAME_COLUMNS)
    return MessageCodec(DEFINITIONS | {TICK_NAMES: names})


def _numbers(columns: Sequence[Column], code: str) -> list[tuple[str, str, tuple[int]]]:
    return [(column.name, code, (len(column.parts),)) for column in columns]


HEADER_FIELDS = [
    ("start", "S4"),
    ("sec", "<i4"),
    ("nanosec", "<u4"),
    ("frame_id", "<u4"),
    ("end", "<u4"),
]


def _tick_layout(reals: Sequence[Column]) -> np.dtype[Any]:
    return np.dtype(
        [
            *HEADER_FIELDS,
            *_numbers(INTEGER_COLUMNS, "<i8"),
            *_numbers(reals, "<f8"),
            *_numbers(FLAG_COLUMNS, "?"),
        ]
    )


TICK = _tick_layout(REAL_COLUMNS)
"""Layout of a tick without its names."""

TICKS = {
    _tick_definition(reals, names): _tick_layout(reals)
    for names in (FORMER_NAMES, EMPTY)
    for reals in REALS_BY_VERSION
}
"""Layout of a tick in each version of the format, by definition."""

TRUTH_LAYOUT = np.dtype(
    [("start", "S20"), *((name, "<f8", (len(parts),)) for name, parts in TRUTH_COLUMNS.items())]
)


def encode_tick(tick: Tick) -> bytes:
    """Encode a tick. Its stamp is the time of the observation."""
    integers = (column.value_of(tick) for column in INTEGER_COLUMNS)
    reals = (np.asarray(column.value_of(tick), np.float64).ravel() for column in REAL_COLUMNS)
    flags, names = (
        (column.value_of(tick) for column in FLAG_COLUMNS),
        (column.value_of(tick) for column in NAME_COLUMNS),
    )
    header = codec().header(tick.observation.now)
    return codec().encode("rcmservo_msgs/msg/Tick", header, *integers, *reals, *flags, *names)


def decode_names(data: bytes, layout: np.dtype[Any]) -> tuple[str, ...]:
    """Return the names at the end of a tick whose numbers have a layout of `TICKS`."""
    offset = layout.itemsize + -layout.itemsize % 4
    names = codec().decode(TICK_NAMES, ENCAPSULATION + data[offset:])
    return tuple(getattr(names, column.name) for column in NAME_COLUMNS)


def encode_text(words: str) -> bytes:
    """Encode a std_msgs/String."""
    return codec().encode("std_msgs/msg/String", words)


def decode_text(data: bytes) -> str:
    """Return the text of a std_msgs/String."""
    return codec().decode("std_msgs/msg/String", data).data


def encode_operating_state(now: int, mode: Mode) -> bytes:
    """Encode CRTK's operating state; its substate states phase, cause and recovery in words."""
    state, busy = CRTK_STATES.get(mode.phase, "ENABLED"), mode.phase in BUSY_PHASES
    header = codec().header(now)
    return codec().encode("crtk_msgs/msg/OperatingState", header, state, mode.text, True, busy)


def decode_operating_words(data: bytes) -> str:
    """Return the sentence of an operating state."""
    return codec().decode("crtk_msgs/msg/OperatingState", data).substate


def encode_truth(now: int, p1: Floats, p2: Floats, jacobian_error: float) -> bytes:
    """Encode the values that only a simulation knows at a tick."""
    numbers = p1, p2, np.array([jacobian_error])
    return codec().encode("rcmservo_msgs/msg/Truth", codec().header(now), *numbers)


EMPTY_MEMORY_BYTES = 24
"""Size of a memory without numbers: encapsulation, header and count."""


def encode_memory(now: int, numbers: Floats) -> bytes:
    """Encode the state (n,) of a user-defined estimator at a tick."""
    return codec().encode("rcmservo_msgs/msg/Memory", codec().header(now), numbers)


def decode_memory(data: bytes) -> Floats:
    """Return the numbers (n,) of a memory.

    Earlier versions align them to eight bytes even if there are none.
    """
    if data[EMPTY_MEMORY_BYTES - 4 :] == bytes(8):
        data = data[:EMPTY_MEMORY_BYTES]
    return codec().decode("rcmservo_msgs/msg/Memory", data).numbers


def encode_positions(names: Sequence[str], time: int, q: Floats) -> bytes:
    """Encode joints q (3,) measured at `time` ns as sensor_msgs/JointState."""
    return _joint_state(names, time, _to_si(q), NO_VALUES)


def encode_rates(names: Sequence[str], time: int, rates: Floats) -> bytes:
    """Encode joint rates (3,) commanded at `time` ns as sensor_msgs/JointState."""
    return _joint_state(names, time, NO_VALUES, _to_si(rates))


def _joint_state(names: Sequence[str], time: int, positions: Floats, rates: Floats) -> bytes:
    parts = codec().header(time), names, positions, rates, NO_VALUES
    return codec().encode("sensor_msgs/msg/JointState", *parts)


def _to_si(values: Floats) -> Floats:
    """Return joints or rates in SI units; empty if not all are finite.

    JointState cannot otherwise mark unknown values.
    """
    return values * SI_FACTORS if np.isfinite(values).all() else NO_VALUES


def encode_picture(exposure: int, data: bytes) -> bytes:
    """Encode a JPEG file exposed at `exposure` ns as sensor_msgs/CompressedImage."""
    header, pixels = codec().header(exposure, "camera"), np.frombuffer(data, np.uint8)
    return codec().encode("sensor_msgs/msg/CompressedImage", header, "jpeg", pixels)


def decode_picture(data: bytes) -> tuple[int, bytes]:
    """Return the exposure (ns) and the JPEG file of an encoded picture."""
    message = codec().decode("sensor_msgs/msg/CompressedImage", data)
    return time_of(message.header), message.data.tobytes()


def columns(layout: np.dtype[Any], rows: Sequence[bytes]) -> dict[str, NDArray[Any]]:
    """Return messages of one layout as columns (N, size) by name.

    Raises
    ------
    ValueError
        If a message is too short.
    """
    size = layout.itemsize
    joined = b"".join([row[:size] for row in rows])
    if len(joined) != size * len(rows):
        raise ValueError("a message is too short")
    table = np.frombuffer(joined, layout)
    return {
        name: np.ascontiguousarray(table[name]) for name in layout.names or () if layout[name].shape
    }


def tick_columns(layout: np.dtype[Any], rows: Sequence[bytes]) -> dict[str, NDArray[Any]]:
    """Return ticks of a layout of `TICKS` as columns; columns that it lacks are NaN."""
    known = columns(layout, rows)
    return {
        name: known.get(name, np.full((len(rows), *TICK[name].shape), np.nan))
        for name in TICK.names or ()
        if TICK[name].shape
    }
