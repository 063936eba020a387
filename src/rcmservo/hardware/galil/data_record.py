"""The data record (QR, DR): all that the controller tells of itself, in one block of bytes.

    header 4 | general 52 | coordinated motion 26 | 36 for each axis

Little-endian. The four sizes are what QZ tells; a DMC-4040 has four axes and sends 226 bytes.
Source: command reference (QR, QZ) and the EPICS driver's table for the DMC-4000 (motorapp/Galil,
GalilController.cpp, Init4000).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcmservo.errors import RcmServoError

LETTERS = "ABCDEFGH"
"""The axes' names, and the handles'."""

SIZES = 52, 26, 36
"""Bytes of general part, coordinated motion and one axis."""

GENERAL = np.dtype(
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
"""Of the whole controller: flags of blocks, which axes, bytes in all, servo samples since it was
reset, inputs, outputs, how its Ethernet handles stand, TC, a bit for each running thread, errors of
the amplifier."""

AXIS = np.dtype(
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
"""Of one axis: bits below, SC, RP, TP, TE, TD in counts, 64 times TV in counts/s, TT in 1/3255 V,
an analog input, hall sensors, and ZA."""

VELOCITY = 64.0
"""How much more than TV the record tells."""
TORQUE = 3255.0
"""Of its units in a volt."""

MOVING, POSITIONING, NEGATIVE, SLEWING, STOPPING, FINAL, OFF = (
    1 << bit for bit in (15, 14, 7, 5, 4, 3, 0)
)
"""Bits of an axis' status: its profile is under way; that of PA or PR; it heads backward; it has
its speed; it comes to rest by ST or a limit; it comes to rest at its end; its motor is off."""

FORWARD, REVERSE, HOME = 1 << 3, 1 << 2, 1 << 1
"""Bits of an axis' switches, as they stand raw: what a tripped one shows depends on its wiring."""

BLOCKS = 0x87
"""Flags of a whole record: the mark, and the blocks I, T and S."""


class Damaged(RcmServoError):
    """Bytes that are no data record."""


class DataRecord(NamedTuple):
    """A data record."""

    general: Any
    """One row of GENERAL."""
    axes: NDArray[Any]
    """A row of AXIS for each."""


def size_of(axes: int) -> int:
    """Bytes of a whole record."""
    return GENERAL.itemsize + axes * AXIS.itemsize


def blank(axes: int) -> DataRecord:
    """A record in which all but the header is 0."""
    general, rows = np.zeros((), GENERAL), np.zeros(axes, AXIS)
    general["flags"], general["axes"], general["size"] = BLOCKS, (1 << axes) - 1, size_of(axes)
    return DataRecord(general, rows)


def packed(record: DataRecord) -> bytes:
    """A record as bytes."""
    return record.general.tobytes() + record.axes.tobytes()


def unpacked(data: bytes, axes: int) -> DataRecord:
    """The record of a controller with so many axes, or :class:`Damaged`."""
    expected = bytes([BLOCKS, (1 << axes) - 1]) + size_of(axes).to_bytes(2, "little")
    if len(data) != size_of(axes) or data[:4] != expected:
        raise Damaged(
            f"a data record of {axes} axes must have {size_of(axes)} bytes and begin with "
            f"{expected.hex(' ')}, got {len(data)} that begin with {data[:4].hex(' ')}"
        )
    return DataRecord(
        np.frombuffer(data, GENERAL, 1)[0], np.frombuffer(data, AXIS, axes, GENERAL.itemsize)
    )
