"""Datagrams between a servo and an arm in another process.

    servo ─► arm   COMMAND   session, number, time, deadline, rates, enabled
                   REQUEST   number, session, action
    arm ─► servo   STATE     session, time, q, enabled, applied rates, number of the newest command
                   DONE      number of the completed request

Each datagram begins with a mark and ends with a checksum; any other datagram is dropped silently.
The servo that enables the drive draws a random session number, and the arm accepts motion from that
session only. A servo that was suspended therefore moves nothing when it resumes while another one
controls the arm. Times are ns of the wall clock, which all processes of a computer share.
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
from typing import Any, NamedTuple

import numpy as np

from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.interfaces import ArmMeasurement, Command, Floats, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.teach import teach

MARK = b"RCM1"
HEAD = struct.Struct("<4sB")
"""Mark and kind of a datagram."""

CHECKSUM = struct.Struct("<I")
MAX_DATAGRAM_BYTES = 256
MAX_DATAGRAMS_PER_READ = 32
"""Largest number of datagrams read in one call, so that a flood of them cannot block the reader."""

REQUEST_TIMEOUT_S = 2.0
"""Time in s within which an arm must complete a request."""


class NoAnswer(RcmServoError):
    """Error of an arm that does not answer."""


class ArmAction(IntEnum):
    """Action that a servo requests of the arm.

    Attributes
    ----------
    REPORT
        Report the state.
    ENABLE
        Enable the drive for the session of the request.
    HOLD_AT_TARGET
        Hold the tool at the target, so that it can be taught.
    RETURN_TO_START
        Return the tool to the start.
    """

    REPORT = 0
    ENABLE = 1
    HOLD_AT_TARGET = 2
    RETURN_TO_START = 3


class SessionCommand(NamedTuple):
    """Command on its way to the arm.

    Parameters
    ----------
    session : int
        Random number of the servo that enabled the drive.
    command : Command
        Joint rates, or a request to disable the drive. The arm accepts only the latter from a
        session that does not control it.
    """

    session: int
    command: Command


class ArmRequest(NamedTuple):
    """Request of an action.

    Parameters
    ----------
    number : int
        Time of the request in ns, which increases.
    session : int
        Session of the servo that sends it. After ENABLE the arm accepts motion from this
        session only.
    action : ArmAction
        Requested action.
    """

    number: int
    session: int
    action: ArmAction


class ArmState(NamedTuple):
    """State of the arm.

    Parameters
    ----------
    session : int
        Session that controls the arm; 0 before its drive was first enabled.
    time : int
        Time at which the joints were read, ns.
    q : Floats
        Joint values (3,) in rad, rad, mm.
    enabled : bool
        True while the drive is on.
    applied : Floats
        Joint rates (3,) in rad/s, rad/s, mm/s that the arm applies.
    number : int
        Number of the command with these rates; -1 if none arrived since the drive was enabled.
    """

    session: int
    time: int
    q: Floats
    enabled: bool
    applied: Floats
    number: int


class Done(NamedTuple):
    """Report that a request is completed.

    Parameters
    ----------
    number : int
        Number of the request.
    """

    number: int


Message = SessionCommand | ArmRequest | ArmState | Done

LAYOUTS = [struct.Struct(f"<{fields}") for fields in ("Qqqq3dB", "qQB", "Qq3dB3dq", "q")]
"""Layouts of the messages. The kind of a datagram is the position of its layout, from 1."""

COMMAND, REQUEST, STATE, DONE = LAYOUTS


def encode(message: Message) -> bytes:
    """Return a message as one datagram."""
    match message:
        case SessionCommand(session, c):
            return _pack(COMMAND, session, c.number, c.time, c.deadline, *c.rates, c.enabled)
        case ArmRequest():
            return _pack(REQUEST, *message)
        case ArmState(session, time_ns, q, enabled, applied, number):
            return _pack(STATE, session, time_ns, *q, enabled, *applied, number)
        case Done():
            return _pack(DONE, *message)


def _pack(layout: struct.Struct, *fields: float) -> bytes:
    content = HEAD.pack(MARK, LAYOUTS.index(layout) + 1) + layout.pack(*fields)
    return content + CHECKSUM.pack(zlib.crc32(content))


def decode(datagram: bytes) -> Message | None:
    """Return the message in a datagram, or None if the datagram is not exactly one message."""
    end = len(datagram) - CHECKSUM.size
    if end < HEAD.size or CHECKSUM.unpack_from(datagram, end)[0] != zlib.crc32(datagram[:end]):
        return None
    mark, kind = HEAD.unpack_from(datagram)
    if mark != MARK or not 1 <= kind <= len(LAYOUTS):
        return None
    layout: struct.Struct = LAYOUTS[int(kind) - 1]
    try:
        return _make_message(layout, layout.unpack(datagram[HEAD.size : end]))
    except (struct.error, ValueError):
        return None


def _make_message(layout: struct.Struct, fields: tuple[Any, ...]) -> Message:
    if layout is COMMAND:
        session, number, time_ns, deadline, *rates, enabled = fields
        command = Command(number, time_ns, deadline, np.array(rates), bool(enabled))
        return SessionCommand(session, command)
    if layout is REQUEST:
        number, session, action = fields
        return ArmRequest(number, session, ArmAction(action))
    if layout is STATE:
        session, time_ns, *q, enabled, applied_1, applied_2, applied_3, number = fields
        applied = np.array((applied_1, applied_2, applied_3))
        return ArmState(session, time_ns, np.array(q), bool(enabled), applied, number)
    return Done(*fields)


def open_socket(path: Path) -> socket.socket:
    """Open a non-blocking datagram socket at a path."""
    new_socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        new_socket.bind(str(path))
    except OSError as error:
        new_socket.close()
        raise UnusableFile(path, f"cannot be a socket: {error.strerror or error}") from error
    new_socket.setblocking(False)
    return new_socket


def receive(source: socket.socket) -> list[tuple[Message, str]]:
    """Return the waiting messages with their senders; drop every other datagram."""
    messages: list[tuple[Message, str]] = []
    with contextlib.suppress(OSError):
        for _ in range(MAX_DATAGRAMS_PER_READ):
            datagram, sender = source.recvfrom(MAX_DATAGRAM_BYTES)
            message = decode(datagram)
            if message is not None:
                messages.append((message, sender))
    return messages


def arm_socket_path(folder: Path) -> Path:
    """Return the path of the socket on which the arm of a folder listens."""
    return folder / "arm"


class RemoteArm:
    """Arm in another process, reached by datagrams. Close it at the end.

    The arm reports the rates that it applies only in its next state, so `apply` returns the rates
    of the newest state.

    Parameters
    ----------
    folder : Path
        Folder of the sockets.

    Raises
    ------
    NoAnswer
        If the arm does not answer.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / f"servo-{os.getpid()}-{secrets.token_hex(4)}"
        self._socket = open_socket(self._path)
        self._session = 0
        self._state: ArmState | None = None
        try:
            self._socket.connect(str(arm_socket_path(folder)))
            self.request(ArmAction.REPORT)
        except OSError as error:
            self.close()
            raise NoAnswer(f"the arm cannot be reached: {error.strerror}") from error
        except NoAnswer:
            self.close()
            raise

    def close(self) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)

    def enable(self) -> None:
        """Enable the drive for this servo only."""
        self._session = secrets.randbits(64)
        self.request(ArmAction.ENABLE)

    def request(self, action: ArmAction) -> None:
        """Request an action and wait until it is completed and a state has arrived.

        Raises
        ------
        NoAnswer
            If the arm does not complete it in time.
        """
        self._receive()
        number = time.monotonic_ns()
        self._send(ArmRequest(number, self._session, action))
        is_done = False
        while not is_done or self._state is None:
            remaining_s = REQUEST_TIMEOUT_S - (time.monotonic_ns() - number) * 1e-9
            if remaining_s <= 0.0:
                raise NoAnswer(f"the arm does not answer within {REQUEST_TIMEOUT_S:g} s")
            select.select([self._socket], [], [], remaining_s)
            is_done |= self._receive(number)

    def measure(self) -> ArmMeasurement:
        """Return the newest state. The drive counts as enabled only in this servo's session."""
        self._receive()
        state = self._newest_state
        return ArmMeasurement(state.time, state.q, state.enabled and state.session == self._session)

    def apply(self, command: Command) -> Floats:
        self._send(SessionCommand(self._session, command))
        state = self._newest_state
        return state.applied if state.session == self._session else np.zeros(3)

    @property
    def _newest_state(self) -> ArmState:
        assert self._state is not None
        return self._state

    def _send(self, message: Message) -> None:
        """Send a message; it is lost if it cannot be sent at once, such as when the arm is gone."""
        with contextlib.suppress(OSError):
            self._socket.send(encode(message))

    def _receive(self, number: int = -1) -> bool:
        """Receive all waiting messages; return True if one completes the request of this number."""
        is_done = False
        for message, _ in receive(self._socket):
            is_done |= message == Done(number)
            if isinstance(message, ArmState):
                is_newest = self._state is None or message.time > self._state.time
                self._state = message if is_newest else self._state
        return is_done


def teach_and_return(plant: Plant, frames: int = TEACHING_FRAMES) -> Target:
    """Teach a target while the arm holds the tool there, then return the tool to the start."""
    arm = plant.arm
    assert isinstance(arm, RemoteArm)
    arm.request(ArmAction.HOLD_AT_TARGET)
    target = teach(plant, frames)
    arm.request(ArmAction.RETURN_TO_START)
    return target
