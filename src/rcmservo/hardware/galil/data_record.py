"""Data record (QR, DR) of a Galil controller: its whole state in one block of bytes.

    header 4 | general 52 | coordinated motion 26 | 36 per axis

The layout is little-endian. QZ reports the axis count and the three block sizes. The record of a
DMC-4040 (four axes) has 226 bytes.

Sources: command reference (QR, QZ); the EPICS driver's table for the DMC-4000 (motorapp/Galil,
GalilController.cpp, Init4000).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcmservo.errors import RcmServoError

AXIS_LETTERS = "ABCDEFGH"
"""Names of the axes. The Ethernet handles have the same names."""

BLOCK_SIZES = 52, 26, 36
"""Bytes of the general block, the coordinated motion block and one axis block."""

GENERAL_DTYPE = np.dtype(
    {
        "names": [
            "flags",
            "axes",
            "size",
            "sample",
            "inputs",
            "outputs",
            "handles",
            "error",
            "threads",
            "amplifier",
        ],
        "formats": ["u1", "u1", "<u2", "<u2", "(10,)u1", "(10,)u1", "(8,)u1", "u1", "u1", "<u4"],
        "offsets": [0, 1, 2, 4, 6, 16, 42, 50, 51, 52],
        "itemsize": 82,
    }
)
"""Controller part: block flags, one bit per axis, record size in bytes, servo samples since the
reset, inputs, outputs, state of each Ethernet handle, error code (TC), one bit per running thread,
amplifier errors."""

AXIS_DTYPE = np.dtype(
    [
        ("status", "<u2"),
        ("switches", "u1"),
        ("stop", "u1"),
        ("reference", "<i4"),
        ("position", "<i4"),
        ("error", "<i4"),
        ("auxiliary", "<i4"),
        ("velocity", "<i4"),
        ("torque", "<i4"),
        ("analog", "<i2"),
        ("hall", "u1"),
        ("reserved", "u1"),
        ("user", "<i4"),
    ]
)
"""Axis part: status bits and switch bits (below), stop code (SC); RP, TP, TE and TD in counts; 64
times TV in counts/s; TT in 1/3255 V; analog input, Hall sensors, and the user variable ZA."""

VELOCITY_SCALE = 64.0
"""Ratio of the recorded velocity to TV."""
TORQUE_UNITS_PER_VOLT = 3255.0

MOVING, POSITIONING, NEGATIVE, SLEWING, STOPPING, FINAL, MOTOR_OFF = (
    1 << bit for bit in (15, 14, 7, 5, 4, 3, 0)
)
"""Status bits of an axis: its profile runs; that profile is a PA or PR move; it moves backward; it
has reached its slew speed; it decelerates after ST or at a limit; it decelerates to the end of its
move; its motor is off."""

FORWARD_SWITCH, REVERSE_SWITCH, HOME_SWITCH = 1 << 3, 1 << 2, 1 << 1
"""Switch bits of an axis as raw input levels. The level of a tripped switch depends on its
wiring."""
SWITCHES = FORWARD_SWITCH | REVERSE_SWITCH | HOME_SWITCH

HEADER_FLAGS = 0x87
"""Flags of a complete record: the marker bit and the blocks I, T and S."""


class InvalidRecord(RcmServoError):
    """Error of bytes that are not a data record."""


class DataRecord(NamedTuple):
    """Decoded data record.

    Parameters
    ----------
    general : Any
        Controller part, one row of ``GENERAL_DTYPE``.
    axes : NDArray[Any]
        Axis parts, one row of ``AXIS_DTYPE`` per axis.
    """

    general: Any
    axes: NDArray[Any]


def record_size(axis_count: int) -> int:
    """Return the size of a complete record in bytes."""
    return GENERAL_DTYPE.itemsize + axis_count * AXIS_DTYPE.itemsize


def empty_record(axis_count: int) -> DataRecord:
    """Return a record with a valid header and zeros elsewhere."""
    general, rows = np.zeros((), GENERAL_DTYPE), np.zeros(axis_count, AXIS_DTYPE)
    general["flags"], general["axes"] = HEADER_FLAGS, (1 << axis_count) - 1
    general["size"] = record_size(axis_count)
    return DataRecord(general, rows)


def encode_record(record: DataRecord) -> bytes:
    """Encode a record as bytes."""
    return record.general.tobytes() + record.axes.tobytes()


def decode_record(data: bytes, axis_count: int) -> DataRecord:
    """Decode the record of a controller, or raise :class:`InvalidRecord`."""
    size = record_size(axis_count)
    header = bytes([HEADER_FLAGS, (1 << axis_count) - 1]) + size.to_bytes(2, "little")
    if len(data) != size or data[:4] != header:
        raise InvalidRecord(
            f"a data record of {axis_count} axes must have {size} bytes and begin with "
            f"{header.hex(' ')}, got {len(data)} bytes that begin with {data[:4].hex(' ')}"
        )
    return DataRecord(
        np.frombuffer(data, GENERAL_DTYPE, 1)[0],
        np.frombuffer(data, AXIS_DTYPE, axis_count, GENERAL_DTYPE.itemsize),
    )
