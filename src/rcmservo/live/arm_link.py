"""The wire between a servo and an arm in another process: datagrams that are whole or nothing.

    servo ─► arm   ORDER   session, number, time, deadline, rates, enabled
                   ASK     number, session, what a person wants done
    arm ─► servo   ANSWER  session, time, q, enabled, applied rates, newest command's number
                   DONE    the number of what was asked and is done

Each begins with a mark and ends with a checksum; anything else is dropped without a word. Whoever
switches the drive on draws a session at random, and the arm takes motion from that session only: a
servo that was stopped and goes on later, while another has the arm, moves nothing. Times are ns of
the wall clock, which all processes of a computer share.
"""

import contextlib
import os
import secrets
import select
import socket
import struct
import time
import zlib
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.interfaces import Command, Floats, Measured, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.shown import TEACHING_FRAMES
from rcmservo.loop.teach import teach

MARK = b"RCM1"
HEAD, SUM = struct.Struct("<4sB"), struct.Struct("<I")
LARGEST = 256
"""Bytes; no datagram is longer."""

AT_ONCE = 32
"""Datagrams that are read in one go: a flood must not hold anybody."""

PATIENCE = 2.0
"""s within which an arm does what a person asks for."""


class NoAnswer(RcmServoError):
    """An arm that cannot be reached."""


class Wish(IntEnum):
    """What a person asks an arm for: an answer, its drive, and where to hold the tool."""

    ANSWER = 0
    ENABLE = 1
    SHOW = 2
    HOME = 3


class Order(NamedTuple):
    """A command on its way to the arm."""

    session: int
    """Whose it is: drawn at random by the servo that switched the drive on."""
    command: Command
    """What the arm is to do. From a session that does not have it, it takes nothing but to be
    switched off."""


class Ask(NamedTuple):
    """Something a person wants done."""

    number: int
    """It rises: the time ns at which it was asked."""
    session: int
    """That of the servo that asks; with ENABLE the arm takes motion from this session alone."""
    wish: Wish
    """What is wanted."""


class Answer(NamedTuple):
    """How the arm is."""

    session: int
    """The one that has it; 0 before its drive was first on."""
    time: int
    """When the joints were read, ns."""
    q: Floats
    """The joints (3,) rad, rad, mm."""
    enabled: bool
    """Whether its drive is on."""
    applied: Floats
    """The joint rates (3,) rad/s, rad/s, mm/s that it takes."""
    number: int
    """Of the command that they came with; -1 where none has come since the drive went on."""


class Done(NamedTuple):
    """What was asked is done."""

    number: int
    """That of the Ask."""


Message = Order | Ask | Answer | Done

ORDER, ASK, ANSWER, DONE = (
    struct.Struct(f"<{form}") for form in ("Qqqq3dB", "qQB", "Qq3dB3dq", "q")
)


def packed(message: Message) -> bytes:
    """A message as one datagram."""
    match message:
        case Order(session, c):
            kind, body = (
                1,
                ORDER.pack(session, c.number, c.time, c.deadline, *c.rates.tolist(), c.enabled),
            )
        case Ask():
            kind, body = 2, ASK.pack(*message)
        case Answer(session, at, q, enabled, applied, number):
            kind, body = (
                3,
                ANSWER.pack(session, at, *q.tolist(), enabled, *applied.tolist(), number),
            )
        case Done():
            kind, body = 4, DONE.pack(*message)
    whole = HEAD.pack(MARK, kind) + body
    return whole + SUM.pack(zlib.crc32(whole))


def unpacked(datagram: bytes) -> Message | None:
    """The message in a datagram, or None if it is not exactly one."""
    end = len(datagram) - SUM.size
    if end < HEAD.size or SUM.unpack_from(datagram, end)[0] != zlib.crc32(datagram[:end]):
        return None
    mark, kind = HEAD.unpack_from(datagram)
    try:
        return _message(kind, datagram[HEAD.size : end]) if mark == MARK else None
    except (struct.error, ValueError):
        return None


def _message(kind: int, body: bytes) -> Message | None:
    match kind:
        case 1:
            session, number, at, deadline, *rates, enabled = ORDER.unpack(body)
            return Order(session, Command(number, at, deadline, np.array(rates), bool(enabled)))
        case 2:
            number, session, wish = ASK.unpack(body)
            return Ask(number, session, Wish(wish))
        case 3:
            v = ANSWER.unpack(body)
            return Answer(v[0], v[1], np.array(v[2:5]), bool(v[5]), np.array(v[6:9]), v[9])
        case 4:
            return Done(*DONE.unpack(body))
        case _:
            return None


def opened(path: Path) -> socket.socket:
    """A socket for datagrams under this path; reading and writing never wait."""
    wire = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        wire.bind(str(path))
    except OSError as error:
        wire.close()
        raise UnusableFile(path, f"cannot be a socket: {error.strerror or error}") from error
    wire.setblocking(False)
    return wire


def received(wire: socket.socket) -> list[tuple[Message, str]]:
    """The messages that wait in the wire and their senders, what is none of them dropped."""
    found: list[tuple[Message, str]] = []
    with contextlib.suppress(OSError):
        for _ in range(AT_ONCE):
            datagram, sender = wire.recvfrom(LARGEST)
            message = unpacked(datagram)
            if message is not None:
                found.append((message, sender))
    return found


def arm_in(folder: Path) -> Path:
    """Where the arm of this folder listens."""
    return folder / "arm"


class RemoteArm:
    """An arm at the other end of a wire. Close it when done.

    What it takes of a command is known from its next answer, so that `apply` gives what the newest
    one tells.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / f"servo-{os.getpid()}-{secrets.token_hex(4)}"
        self._wire = opened(self._path)
        self._session = 0
        self._answer: Answer | None = None
        try:
            self._wire.connect(str(arm_in(folder)))
            self.ask(Wish.ANSWER)
        except OSError as error:
            self.close()
            raise NoAnswer(f"the arm cannot be reached: {error.strerror}") from error
        except NoAnswer:
            self.close()
            raise

    def close(self) -> None:
        self._wire.close()
        self._path.unlink(missing_ok=True)

    def enable(self) -> None:
        """Switch the drive on for this servo alone."""
        self._session = secrets.randbits(64)
        self.ask(Wish.ENABLE)

    def ask(self, wish: Wish) -> None:
        """Ask for something that a person may, and wait until it is done and the newest answer
        tells of it."""
        self._take()
        number = time.monotonic_ns()
        self._send(Ask(number, self._session, wish))
        done = False
        while not done or self._answer is None:
            left = PATIENCE - (time.monotonic_ns() - number) * 1e-9
            if left <= 0.0:
                raise NoAnswer(f"the arm does not answer within {PATIENCE:g} s")
            select.select([self._wire], [], [], left)
            done |= self._take(number)

    def measure(self) -> Measured:
        """The newest answer. The drive is on for us only in our own session."""
        self._take()
        answer = self._newest
        return Measured(answer.time, answer.q, answer.enabled and answer.session == self._session)

    def apply(self, command: Command) -> Floats:
        self._send(Order(self._session, command))
        answer = self._newest
        return answer.applied if answer.session == self._session else np.zeros(3)

    @property
    def _newest(self) -> Answer:
        assert self._answer is not None
        return self._answer

    def _send(self, message: Message) -> None:
        """What cannot be sent now is lost, like any datagram; an arm that is gone shows by its
        silence."""
        with contextlib.suppress(OSError):
            self._wire.send(packed(message))

    def _take(self, number: int = -1) -> bool:
        """Take what has come; whether what was asked under this number is done."""
        done = False
        for message, _ in received(self._wire):
            done |= message == Done(number)
            if isinstance(message, Answer) and (
                self._answer is None or message.time > self._answer.time
            ):
                self._answer = message
        return done


def shown_and_brought_back(plant: Plant, frames: int = TEACHING_FRAMES) -> Target:
    """A target that a person shows at the other end of the wire, who then brings the tool back to
    the start."""
    arm = plant.arm
    assert isinstance(arm, RemoteArm)
    arm.ask(Wish.SHOW)
    target = teach(plant, frames)
    arm.ask(Wish.HOME)
    return target
