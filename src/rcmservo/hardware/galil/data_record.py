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
    [
        ("flags", "u1"),  # marker bit, and one bit per block of the record
        ("axes", "u1"),  # one bit per axis
        ("size", "<u2"),  # size of the record in bytes
        ("sample", "<u2"),  # servo samples since the reset, modulo 2^16
        ("inputs", "10u1"),
        ("outputs", "10u1"),
        ("reserved", "V16"),
        ("handles", "8u1"),  # state of each Ethernet handle
        ("error", "u1"),  # error code (TC)
        ("threads", "u1"),  # one bit per running thread
        ("amplifier", "<u4"),  # amplifier errors
        ("coordinated", "V26"),  # coordinated motion, which this project does not use
    ]
)
"""Header, general block and coordinated motion block."""

AXIS_DTYPE = np.dtype(
    [
        ("status", "<u2"),  # bits such as MOVING below
        ("switches", "u1"),  # bits such as FORWARD_SWITCH below
        ("stop", "u1"),  # stop code (SC)
        ("reference", "<i4"),  # commanded position (RP), counts
        ("position", "<i4"),  # measured position (TP), counts
        ("error", "<i4"),  # position error (TE), counts
        ("auxiliary", "<i4"),  # position of the auxiliary encoder (TD), counts
        ("velocity", "<i4"),  # 64 times the speed (TV), counts/s
        ("torque", "<i4"),  # motor command (TT), 1/3255 V
        ("analog", "<i2"),  # analog input
        ("hall", "u1"),  # Hall sensors
        ("reserved", "u1"),
        ("user", "<i4"),  # user variable ZA
    ]
)
"""Block of one axis."""

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
    """Error of bytes that are not a complete data record."""


class DataRecord(NamedTuple):
    """Decoded data record.

    Parameters
    ----------
    general : Any
        State of the controller, one row of ``GENERAL_DTYPE``.
    axes : NDArray[Any]
        States of the axes, one row of ``AXIS_DTYPE`` per axis.
    """

    general: Any
    axes: NDArray[Any]


def record_size(axis_count: int) -> int:
    """Return the size of a complete record in bytes."""
    return GENERAL_DTYPE.itemsize + axis_count * AXIS_DTYPE.itemsize


def empty_record(axis_count: int) -> DataRecord:
    """Return a record with a valid header and zeros elsewhere."""
    general = np.zeros((), GENERAL_DTYPE)
    general["flags"], general["axes"] = HEADER_FLAGS, (1 << axis_count) - 1
    general["size"] = record_size(axis_count)
    return DataRecord(general, np.zeros(axis_count, AXIS_DTYPE))


def encode_record(record: DataRecord) -> bytes:
    """Encode a record as bytes."""
    return record.general.tobytes() + record.axes.tobytes()


def decode_record(data: bytes, axis_count: int) -> DataRecord:
    """Decode the record of a controller, or raise :class:`InvalidRecord`."""
    size, header = record_size(axis_count), encode_record(empty_record(axis_count))[:4]
    if len(data) != size or data[:4] != header:
        raise InvalidRecord(
            f"a data record of {axis_count} axes must have {size} bytes and begin with "
            f"{header.hex(' ')}, got {len(data)} bytes that begin with {data[:4].hex(' ')}"
        )
    axes = np.frombuffer(data, AXIS_DTYPE, axis_count, GENERAL_DTYPE.itemsize)
    return DataRecord(np.frombuffer(data, GENERAL_DTYPE, 1)[0], axes)
