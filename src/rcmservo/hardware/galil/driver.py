"""An arm whose joints hang on three axes of a Galil controller.

A thread of its own talks with the controller, so that the loop never waits for it. What it hears
last is what `measure` tells: where the controller does not answer, that grows old, and the servo
stops. A connection that is lost is not made again by itself.
"""

import contextlib
import threading
import time
from collections.abc import Generator

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.hardware.galil.session import ArmReading, GalilSession
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.hardware.galil.wire import ByteStream, Conversation, SerialStream, TcpStream
from rcmservo.interfaces import Command, Floats, Measured
from rcmservo.live.lab import NotReady
from rcmservo.live.realtime import urgent
from rcmservo.method.kinematics import JointLimits

LOOK = 0.004
"""s between two data records where no command comes."""

SERVOING = 115200
"""bits/s of a serial port at least: some 350 bytes a command then take 30 ms."""


class GalilArm:
    """An arm on a Galil controller, set up with its motors off; `close` it at the end."""

    def __init__(self, settings: GalilSettings, limits: JointLimits) -> None:
        self.settings = settings
        self._talks: list[Conversation] = []
        self._lock, self._wake, self._over = threading.Lock(), threading.Event(), False
        self._handing = threading.Lock()
        """Held while a command passes from the loop to the thread, and never for long."""
        self._next: Command | None = None
        self._lost = ""
        self._measured = Measured(0, np.zeros(3), False)
        try:
            talk = self._connected()
            messages = None if settings.serial else self._connected()
            self._session = GalilSession(talk, messages, settings, limits)
            self._session.set_up()
            self._measured = self._told(self._session.look())
        except BaseException:
            self._hang_up()
            raise
        self._thread = threading.Thread(target=self._run, name="galil", daemon=True)
        self._thread.start()

    @property
    def why_off(self) -> str:
        """Why the drive went off by itself, in a sentence; empty where it did not."""
        return self._lost or self._session.why_off

    def enable(self) -> None:
        """Switch the motors on, at rest, watched over by the controller."""
        if self.settings.serial and self.settings.baud < SERVOING:
            raise NotReady(
                f"at {self.settings.baud} bits/s a command takes longer than the controller waits "
                f"for the next: servo by network, or at {SERVOING} bits/s"
            )
        with self._in_use():
            self._taken()
            self._session.start()
            self._measured = self._told(self._session.look())

    def define(self, q: Floats) -> None:
        """A person says that the joints (3,) stand at q, at rest and with the drive off."""
        with self._in_use():
            self._session.define(q)
            self._measured = self._told(self._session.look())

    def homed(self) -> bool:
        """Whether a person has said where the arm stands since the controller was reset."""
        with self._in_use():
            return self._session.homed()

    def measure(self) -> Measured:
        """What the controller told last."""
        return self._measured

    def apply(self, command: Command) -> Floats:
        """Pass a command on; the joint rates (3,) as the controller's steps have them."""
        with self._handing:
            if self._next is None or self._next.enabled:  # nothing replaces switching off
                self._next = command
        self._wake.set()
        if not (command.enabled and self._measured.enabled):
            return np.zeros(3)
        return self._session.steps(command.rates) / np.array(self.settings.counts)

    def close(self) -> None:
        """Stop, switch off, and hang up."""
        self._over = True
        self._wake.set()
        self._thread.join()
        if self._session.watched:  # else it is off, and maybe somebody else's by now
            try:
                self._session.switch_off()
            except RcmServoError as error:
                self._lost = self._lost or str(error)
        self._hang_up()

    def _connected(self) -> Conversation:
        s = self.settings
        stream: ByteStream = (
            SerialStream(s.address, s.baud, s.answer_within)
            if s.serial
            else TcpStream(s.address, s.port, s.answer_within)
        )
        self._talks.append(Conversation(stream, s.answer_within))
        return self._talks[-1]

    def _run(self) -> None:
        urgent()
        while not self._over:
            self._wake.wait(LOOK)
            self._wake.clear()
            with self._lock:
                try:
                    self._turn()
                except RcmServoError as error:
                    self._lost = str(error)
                    self._hang_up()
                    return

    def _turn(self) -> None:
        command, session = self._taken(), self._session
        if command is not None and session.watched:
            if not command.enabled:
                session.switch_off()
            elif time.monotonic_ns() <= command.deadline:
                self._measured = self._told(session.exchange(command.rates))
                return
        self._measured = self._told(session.look())

    def _taken(self) -> Command | None:
        """The newest command, which is not there any more."""
        with self._handing:
            command, self._next = self._next, None
        return command

    def _told(self, told: ArmReading) -> Measured:
        """What the controller tells, when its samples say; time never goes back."""
        return Measured(max(round(1e9 * told.time), self._measured.time), told.q, told.on)

    @contextlib.contextmanager
    def _in_use(self) -> Generator[None]:
        with self._lock:
            if not self._thread.is_alive():
                raise NotReady(f"{self._lost or 'the controller is lost'}; connect again")
            yield

    def _hang_up(self) -> None:
        for talk in self._talks:
            talk.close()
