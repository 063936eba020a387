"""Messages of a record: topics, ROS 2 definitions, and encoding in CDR, the byte format of ROS 2.

A tick holds numbers of fixed size first and enum names last, so each number has a fixed offset.
NumPy therefore reads all ticks as columns with one layout. Decoding each tick separately would take
sixty times as long (40 us instead of 0.6 us). A header's stamp is a time on the plant's clock.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick
from rcmservo.recording import tick_schema as schema
from rcmservo.recording.cdr import MessageCodec, read_stamp
from rcmservo.recording.tick_schema import Column
from rcmservo.safety.state_machine import Mode, Phase

CRTK_STATE_PHASES = Phase.DISABLED, Phase.PAUSED, Phase.FAULT
"""Phases that have a state of the same name in CRTK, the common interface of surgical robots. All
other phases are its state ENABLED."""

BUSY_PHASES = Phase.ACQUIRE, Phase.SERVO, Phase.JOG
"""Phases in which the arm moves."""

NO_VALUES = np.empty(0)
"""Unknown positions, rates or efforts of a JointState."""

NO_RENAMES: Mapping[str, str] = MappingProxyType({})

SI_FACTORS = np.array([1.0, 1.0, 1e-3])
"""Factors from rad, rad, mm to SI units."""

TIME_DEFINITION = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
SEPARATOR_LINE = "=" * 80 + "\n"
HEADER_DEFINITIONS = (
    f"{SEPARATOR_LINE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring "
    f"frame_id\n{SEPARATOR_LINE}{TIME_DEFINITION}"
)


def _define_message(*fields: str) -> str:
    """Return the ROS 2 definition of a message with a header and these fields."""
    return "\n".join(["std_msgs/Header header", *fields]) + "\n" + HEADER_DEFINITIONS


def _define_tick(reals: Sequence[Column], renames: Mapping[str, str] = NO_RENAMES) -> str:
    """Return the definition of a tick with the real numbers `reals`.

    `renames` maps present names of columns to their former names.
    """
    groups = (
        ("int64", schema.INTEGER_COLUMNS),
        ("float64[{size}]", reals),
        ("bool", schema.FLAG_COLUMNS),
        ("string", schema.NAME_COLUMNS),
    )
    return _define_message(
        *(
            f"{ros2_type.format(size=len(parts))} {renames.get(name, name).lower()}"
            for ros2_type, columns in groups
            for name, parts, _ in columns
        )
    )


REALS_BY_VERSION = [
    [
        column
        for column in schema.REAL_COLUMNS
        if column.name not in chain(*schema.ADDED_COLUMNS[version:])
    ]
    for version in range(len(schema.ADDED_COLUMNS) + 1)
]
"""Real numbers of a tick in each version of the format."""

DEFINITIONS = {
    "std_msgs/msg/String": "string data\n",
    "sensor_msgs/msg/JointState": _define_message(
        "string[] name", "float64[] position", "float64[] velocity", "float64[] effort"
    ),
    "crtk_msgs/msg/OperatingState": _define_message(
        "string state", "string substate", "bool is_homed", "bool is_busy"
    ),
    "sensor_msgs/msg/CompressedImage": _define_message("string format", "uint8[] data"),
    "rcmservo_msgs/msg/Truth": _define_message(
        *(f"float64[{len(parts)}] {name}" for name, parts in schema.TRUTH_COLUMNS.items())
    ),
    "rcmservo_msgs/msg/Memory": _define_message("float64[] numbers"),
    "rcmservo_msgs/msg/Tick": _define_tick(schema.REAL_COLUMNS),
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
"""First bytes of a message with little endian numbers."""

TICK_NAMES = "rcmservo_msgs/msg/Names"
"""Message type of the enum names at the end of a tick."""


@cache
def get_codec() -> MessageCodec:
    """Return the codec of all message types of a record."""
    names_definition = "".join(f"string {column.name}\n" for column in schema.NAME_COLUMNS)
    return MessageCodec(DEFINITIONS | {TICK_NAMES: names_definition})


HEADER_FIELDS = [
    ("start", "S4"),
    ("sec", "<i4"),
    ("nanosec", "<u4"),
    ("frame_id", "<u4"),
    ("end", "<u4"),
]
"""NumPy fields of the bytes before the first number of a tick."""


def _build_tick_layout(reals: Sequence[Column]) -> np.dtype[Any]:
    """Return the layout of a tick without its names; each column is an array (size,)."""
    groups = (schema.INTEGER_COLUMNS, "<i8"), (reals, "<f8"), (schema.FLAG_COLUMNS, "?")
    fields = [
        (column.name, code, (len(column.parts),)) for columns, code in groups for column in columns
    ]
    return np.dtype([*HEADER_FIELDS, *fields])


TICK = _build_tick_layout(schema.REAL_COLUMNS)
"""Layout of a tick without its names."""

TICKS = {
    _define_tick(reals, renames): _build_tick_layout(reals)
    for renames in (schema.FORMER_NAMES, NO_RENAMES)
    for reals in REALS_BY_VERSION
}
"""Layout of a tick in each version of the format, by the definition of its message."""

TRUTH_LAYOUT = np.dtype(
    [
        ("start", "S20"),
        *((name, "<f8", (len(parts),)) for name, parts in schema.TRUTH_COLUMNS.items()),
    ]
)
"""Layout of the values that only a simulation knows; `start` are the bytes before the first."""


def encode_tick(tick: Tick) -> bytes:
    """Encode a tick. Its stamp is the time of the observation."""
    integers, flags, names = (
        [column.value_of(tick) for column in columns]
        for columns in (schema.INTEGER_COLUMNS, schema.FLAG_COLUMNS, schema.NAME_COLUMNS)
    )
    reals = (
        np.asarray(column.value_of(tick), np.float64).ravel() for column in schema.REAL_COLUMNS
    )
    header = get_codec().make_header(tick.observation.now)
    return get_codec().encode("rcmservo_msgs/msg/Tick", header, *integers, *reals, *flags, *names)


def decode_names(data: bytes, layout: np.dtype[Any]) -> tuple[str, ...]:
    """Return the enum names at the end of a tick whose numbers have a layout of `TICKS`.

    CDR aligns the first name to four bytes.
    """
    offset = layout.itemsize + -layout.itemsize % 4
    names = get_codec().decode(TICK_NAMES, ENCAPSULATION + data[offset:])
    return tuple(getattr(names, column.name) for column in schema.NAME_COLUMNS)


def encode_text(text: str) -> bytes:
    """Encode a std_msgs/String."""
    return get_codec().encode("std_msgs/msg/String", text)


def decode_text(data: bytes) -> str:
    """Return the text of a std_msgs/String."""
    return get_codec().decode("std_msgs/msg/String", data).data


def encode_operating_state(now: int, mode: Mode) -> bytes:
    """Encode CRTK's operating state; its substate gives phase, cause and remedy in words."""
    state = mode.phase.name if mode.phase in CRTK_STATE_PHASES else "ENABLED"
    is_homed, is_busy = True, mode.phase in BUSY_PHASES
    fields = get_codec().make_header(now), state, mode.text, is_homed, is_busy
    return get_codec().encode("crtk_msgs/msg/OperatingState", *fields)


def decode_operating_words(data: bytes) -> str:
    """Return the sentence of an operating state."""
    return get_codec().decode("crtk_msgs/msg/OperatingState", data).substate


def encode_truth(now: int, p1: Floats, p2: Floats, jacobian_error: float) -> bytes:
    """Encode the values that only a simulation knows at a tick."""
    fields = get_codec().make_header(now), p1, p2, np.array([jacobian_error])
    return get_codec().encode("rcmservo_msgs/msg/Truth", *fields)


COUNT_BYTES = 4
EMPTY_MEMORY_BYTES = 24
"""Size of a memory without numbers in bytes: encapsulation, header, and the count of numbers."""


def encode_memory(now: int, numbers: Floats) -> bytes:
    """Encode the state (n,) of a user-defined estimator at a tick."""
    return get_codec().encode("rcmservo_msgs/msg/Memory", get_codec().make_header(now), numbers)


def decode_memory(data: bytes) -> Floats:
    """Return the state (n,) of a user-defined estimator.

    Earlier versions align an empty state to eight bytes, so four further bytes follow its count.
    """
    if data[EMPTY_MEMORY_BYTES - COUNT_BYTES :] == bytes(8):
        data = data[:EMPTY_MEMORY_BYTES]
    return get_codec().decode("rcmservo_msgs/msg/Memory", data).numbers


def encode_positions(names: Sequence[str], time: int, q: Floats) -> bytes:
    """Encode joints q (3,) measured at `time` ns as sensor_msgs/JointState."""
    return _encode_joint_state(names, time, _convert_to_si(q), NO_VALUES)


def encode_rates(names: Sequence[str], time: int, rates: Floats) -> bytes:
    """Encode joint rates (3,) commanded at `time` ns as sensor_msgs/JointState."""
    return _encode_joint_state(names, time, NO_VALUES, _convert_to_si(rates))


def _encode_joint_state(names: Sequence[str], time: int, positions: Floats, rates: Floats) -> bytes:
    fields = get_codec().make_header(time), names, positions, rates, NO_VALUES
    return get_codec().encode("sensor_msgs/msg/JointState", *fields)


def _convert_to_si(values: Floats) -> Floats:
    """Return joints or joint rates (3,) in SI units; empty if not all are finite.

    JointState has no other way to mark unknown values.
    """
    return values * SI_FACTORS if np.isfinite(values).all() else NO_VALUES


def encode_picture(exposure: int, jpeg: bytes) -> bytes:
    """Encode a JPEG file exposed at `exposure` ns as sensor_msgs/CompressedImage."""
    fields = get_codec().make_header(exposure, "camera"), "jpeg", np.frombuffer(jpeg, np.uint8)
    return get_codec().encode("sensor_msgs/msg/CompressedImage", *fields)


def decode_picture(data: bytes) -> tuple[int, bytes]:
    """Return the exposure (ns) and the JPEG file of an encoded picture."""
    message = get_codec().decode("sensor_msgs/msg/CompressedImage", data)
    return read_stamp(message.header), message.data.tobytes()


def decode_columns(layout: np.dtype[Any], messages: Sequence[bytes]) -> dict[str, NDArray[Any]]:
    """Return N messages of one layout as columns (N, size) by name.

    Raises
    ------
    ValueError
        If a message is too short.
    """
    size = layout.itemsize
    joined = b"".join([message[:size] for message in messages])
    if len(joined) != size * len(messages):
        raise ValueError("a message is too short")
    table = np.frombuffer(joined, layout)
    return {name: np.ascontiguousarray(table[name]) for name in _list_columns(layout)}


def decode_tick_columns(
    layout: np.dtype[Any], messages: Sequence[bytes]
) -> dict[str, NDArray[Any]]:
    """Return ticks of a layout of `TICKS` as columns; columns that it lacks are NaN."""
    known = decode_columns(layout, messages)
    return {
        name: known.get(name, np.full((len(messages), *TICK[name].shape), np.nan))
        for name in _list_columns(TICK)
    }


def _list_columns(layout: np.dtype[Any]) -> list[str]:
    """Return the fields of a layout that are arrays; the others are the start of the message."""
    return [name for name in layout.names or () if layout[name].shape]
