"""The toy arm's wire: datagrams that are whole or nothing.

    host ─► toy   "TOY1", kind, session, number, stamp, three rates, checksum
    toy ─► host   "TOY1", session, number, stamp, on, why, three joints, three rates, checksum

The toy sends each stamp back as it came: so a host knows when it asked what is answered here.
"""

import math
import struct
import zlib
from typing import NamedTuple

ORDER, ANSWER, SUM = struct.Struct("<4sBIIq3d"), struct.Struct("<4sIIqBB6d"), struct.Struct("<I")
MARK = b"TOY1"
ASK, ENABLE, JOG, OFF = range(4)
WHYS = "", "it was told to", "its watchdog ran out"
"""Why the drive is off, in words."""

Three = tuple[float, float, float]


class ToyOrder(NamedTuple):
    """What a host wants."""

    kind: int
    """ASK (an answer alone), ENABLE, JOG or OFF."""
    session: int
    """Of the host: drawn at random, for one time that the drive is on."""
    number: int
    """Of a JOG: it rises in a session."""
    stamp: int
    """ns on the host's clock."""
    rates: Three
    """Of a JOG: rad/s, rad/s, mm/s."""


class ToyAnswer(NamedTuple):
    """How the toy is."""

    session: int
    """Whose it is; 0 before anybody had it."""
    number: int
    """Of the newest JOG that it took in this session."""
    stamp: int
    """That of the order which is answered."""
    on: bool
    """Whether its drive is on."""
    why: int
    """Why it is not, of WHYS."""
    q: Three
    """rad, rad, mm."""
    rates: Three
    """What it takes of the newest JOG: rad/s, rad/s, mm/s."""


def sent(message: ToyOrder | ToyAnswer) -> bytes:
    """A message as a datagram."""
    if isinstance(message, ToyOrder):
        body = ORDER.pack(MARK, *message[:4], *message.rates)
    else:
        body = ANSWER.pack(MARK, *message[:5], *message.q, *message.rates)
    return body + SUM.pack(zlib.crc32(body))


def order_in(datagram: bytes) -> ToyOrder | None:
    """The order in a datagram, or None if it is not exactly one."""
    body = _whole(datagram, ORDER)
    if body is None or body[1] > OFF or not all(map(math.isfinite, body[5:])):
        return None
    return ToyOrder(body[1], body[2], body[3], body[4], body[5:])


def answer_in(datagram: bytes) -> ToyAnswer | None:
    """The answer in a datagram, or None if it is not exactly one."""
    body = _whole(datagram, ANSWER)
    if body is None or body[5] >= len(WHYS):
        return None
    return ToyAnswer(body[1], body[2], body[3], bool(body[4]), body[5], body[6:9], body[9:])


def _whole(datagram: bytes, form: struct.Struct) -> tuple | None:
    if len(datagram) != form.size + SUM.size:
        return None
    body, told = datagram[: form.size], SUM.unpack(datagram[form.size :])[0]
    return form.unpack(body) if body.startswith(MARK) and zlib.crc32(body) == told else None
