"""Decoding of the data record, compared with public sources field by field.

EP   motorapp/Galil, GalilController.cpp, Init4000: the table of offsets
CR   Galil's command reference, QR, QZ, TA
M2   Galil DMC-2x00 user manual, page 68: header, status and switches bit by bit
DR   a measured record of a DMC-4040: 226 bytes
"""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.emulated_host import EmulatedHost
from rcmservo.hardware.galil import data_record as record

HEADER = bytes.fromhex("87 0F E2 00")
"""M2: bit 7 and the blocks I, T, S; axes A to D; 226 bytes in all, low byte first (DR)."""

AXIS_B = bytes.fromhex(
    "A1 80"  # EP +0: moving (15), negative (7), slewing (5), motor off (0)
    "0C"  # EP +2: states of the forward (3) and the reverse limit (2)
    "04"  # EP +3: stop code 4
    "18 FC FF FF"  # EP +4: reference position -1000
    "10 FC FF FF"  # EP +8: motor position -1008
    "08 00 00 00"  # EP +12: position error 8
    "07 00 00 00"  # EP +16: auxiliary position 7
    "00 E7 FF FF"  # EP +20: velocity, 64 times TV (CR): -100 counts/s
    "B7 0C 00 00"  # EP +24: torque, 3255 a volt: 1 V
    "FE FF"  # EP +28: analog input -2
    "05"  # EP +30: hall inputs
    "00"
    "2A 00 00 00"  # EP +32: user variable 42
)


def reference_record() -> bytes:
    """Return a record as the sources describe it."""
    data = bytearray(226)
    data[0:4] = HEADER
    data[4:6] = bytes.fromhex("D2 6D")  # EP 4: sample counter, 28114
    data[42:50] = bytes([2, 1, 0, 0, 0, 0, 0, 255])  # EP 42: the handles, as _IHm2
    data[50] = 22  # EP 50: error code
    data[51] = 0b101  # EP 51: threads 0 and 2
    data[55] = 0b1000  # EP 55 and CR TA: TA0, under-voltage of A-D
    data[82 + 36 : 82 + 72] = AXIS_B
    return bytes(data)


def test_the_fields_of_the_reference_record_are_decoded() -> None:
    general, axes = record.decode_record(reference_record(), 4)
    assert (general["sample"], general["error"], general["threads"]) == (28114, 22, 0b101)
    assert general["handles"].tolist() == [2, 1, 0, 0, 0, 0, 0, 255]
    assert general["amplifier"] >> 24 == 0b1000
    b = axes[1]
    bits = record.MOVING | record.NEGATIVE | record.SLEWING | record.MOTOR_OFF
    assert b["status"] == bits
    assert b["switches"] == record.FORWARD_SWITCH | record.REVERSE_SWITCH
    values = [int(b[name]) for name in ("stop", "reference", "position", "error", "auxiliary")]
    assert values == [4, -1000, -1008, 8, 7]
    assert b["velocity"] / record.VELOCITY_SCALE == -100.0
    assert b["torque"] / record.TORQUE_UNITS_PER_VOLT == 1.0
    assert [int(b[name]) for name in ("analog", "hall", "user")] == [-2, 5, 42]
    assert not axes[[0, 2, 3]].tobytes().strip(b"\0")


@pytest.mark.parametrize("axes", range(1, 9))
def test_the_record_size_matches_QZ(axes: int) -> None:
    """CR QZ " 4, 52, 26, 36" and DR: 226 for four; gclib's record of eight axes has 370."""
    count, *blocks = (int(n) for n in EmulatedHost(axes)(b"QZ\r").split(b"\r")[0].split(b","))
    assert count == axes
    assert record.record_size(axes) == 4 + blocks[0] + blocks[1] + blocks[2] * axes
    assert {4: 226, 8: 370}.get(axes, record.record_size(axes)) == record.record_size(axes)


@given(data=st.binary(min_size=226, max_size=226), cut=st.integers(0, 225))
def test_invalid_bytes_are_never_decoded(data: bytes, cut: int) -> None:
    for invalid in (
        reference_record()[:cut],
        reference_record() + b":",
        b"\x07" + reference_record()[1:],
    ):
        with pytest.raises(record.InvalidRecord):
            record.decode_record(invalid, 4)
    if data[:4] != HEADER:
        with pytest.raises(record.InvalidRecord):
            record.decode_record(data, 4)


def test_the_fields_of_an_emulated_record_have_the_offsets_of_the_table() -> None:
    """The test reads EP's offsets with struct alone."""
    host = EmulatedHost()
    host(b"DP 5000,-300;JG -6400,100;ZAA=42;BG A;MO B\r")
    host.after(1.5)
    data = host(b"QR\r")
    assert len(data) == 227 and data[:4] == HEADER and data[226:] == b":"
    status, switches, stop = struct.unpack_from("<HBB", data, 82)
    assert status == 0x80A0 and stop == 0 and switches & 0b1100 == 0b1100
    reference, position, error = struct.unpack_from("<iii", data, 86)
    assert error == reference - position
    assert position == host.number("_TPA")
    (velocity,) = struct.unpack_from("<i", data, 102)
    assert velocity / 64 == pytest.approx(-6400, rel=0.01)
    assert struct.unpack_from("<i", data, 114) == (42,)
    assert struct.unpack_from("<H", data, 82 + 36)[0] & 1
    assert struct.unpack_from("<i", data, 82 + 36 + 8) == (-300,)
