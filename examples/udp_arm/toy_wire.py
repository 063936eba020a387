"""Protocol of the toy arm: datagrams with a checksum.

    host ─► toy   "TOY1", kind, session, number, stamp, three rates, checksum
    toy ─► host   "TOY1", session, number, stamp, on, why, three joints, three rates, checksum

The toy returns the stamp of each order, so that a host knows the time of the request.
"""

import math
import struct
import zlib
from typing import NamedTuple

ORDER, ANSWER, SUM = struct.Struct("<4sBIIq3d"), struct.Struct("<4sIIqBB6d"), struct.Struct("<I")
MARK = b"TOY1"
ASK, ENABLE, JOG, OFF = range(4)
WHYS = "", "switched off by command", "its watchdog expired"
"""Reasons why the drive is off, as text."""

Three = tuple[float, float, float]


class ToyOrder(NamedTuple):
    """Order of a host.

    Parameters
    ----------
    kind : int
        ASK (request an answer only), ENABLE, JOG or OFF.
    session : int
        Random number of the host, for one period with the drive on.
    number : int
        Number of a JOG, increasing within a session.
    stamp : int
        Time (ns) of the host's clock.
    rates : Three
        Joint rates of a JOG in rad/s, rad/s, mm/s.
    """

    kind: int
    session: int
    number: int
    stamp: int
    rates: Three


class ToyAnswer(NamedTuple):
    """State of the toy arm.

    Parameters
    ----------
    session : int
        Present session; 0 before the first one.
    number : int
        Number of the newest accepted JOG of this session.
    stamp : int
        Stamp of the order that is answered.
    on : bool
        True if the drive is on.
    why : int
        Reason why it is off, an index of `WHYS`.
    q : Three
        Joints in rad, rad, mm.
    rates : Three
        Applied rates of the newest JOG in rad/s, rad/s, mm/s.
    """

    session: int
    number: int
    stamp: int
    on: bool
    why: int
    q: Three
    rates: Three


def sent(message: ToyOrder | ToyAnswer) -> bytes:
    """Return a message as a datagram."""
    if isinstance(message, ToyOrder):
        body = ORDER.pack(MARK, *message[:4], *message.rates)
    else:
        body = ANSWER.pack(MARK, *message[:5], *message.q, *message.rates)
    return body + SUM.pack(zlib.crc32(body))


def order_in(datagram: bytes) -> ToyOrder | None:
    """Return the order in a datagram; None if the datagram is invalid."""
    body = _whole(datagram, ORDER)
    if body is None or body[1] > OFF or not all(map(math.isfinite, body[5:])):
        return None
    return ToyOrder(body[1], body[2], body[3], body[4], body[5:])


def answer_in(datagram: bytes) -> ToyAnswer | None:
    """Return the answer in a datagram; None if the datagram is invalid."""
    body = _whole(datagram, ANSWER)
    if body is None or body[5] >= len(WHYS):
        return None
    return ToyAnswer(body[1], body[2], body[3], bool(body[4]), body[5], body[6:9], body[9:])


def _whole(datagram: bytes, form: struct.Struct) -> tuple | None:
    if len(datagram) != form.size + SUM.size:
        return None
    body, checksum = datagram[: form.size], SUM.unpack(datagram[form.size :])[0]
    return form.unpack(body) if body.startswith(MARK) and zlib.crc32(body) == checksum else None
