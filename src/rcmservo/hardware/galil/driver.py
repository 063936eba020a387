"""Driver of an arm whose three joints are axes of a Galil controller.

A separate thread exchanges commands and data records with the controller, so the servo loop never
waits for it. `measure` returns the last data record. If the controller stops answering, that record
grows old and the servo stops; the controller's own watchdog stops the arm. The driver does not
reconnect by itself.
"""

import contextlib
import threading
import time
from collections.abc import Generator

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.geometry.kinematics import JointLimits
from rcmservo.hardware.galil.connection import GalilConnection, SerialStream, TcpStream
from rcmservo.hardware.galil.session import ArmReading, GalilSession
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.interfaces import ArmMeasurement, Command, Floats
from rcmservo.live.device_protocols import NotReady
from rcmservo.live.realtime import request_urgent_priority

POLL_PERIOD_S = 0.004
"""Period of the data records while no command arrives."""

MIN_SERVO_BAUD = 115200
"""Lowest bit rate of a serial port for servoing: a command of about 350 bytes then takes 30 ms."""


class GalilArm:
    """Arm on a Galil controller. The constructor connects and leaves the motors off.

    Parameters
    ----------
    settings : GalilSettings
        Connection, axes and scales.
    limits : JointLimits
        Joint limits, which become the soft limits of the axes.

    Raises
    ------
    ConnectionLost
        If the controller does not answer.
    NotReady
        If another host or program uses the arm, or the controller is of another kind.
    """

    def __init__(self, settings: GalilSettings, limits: JointLimits) -> None:
        self.settings = settings
        self._connections: list[GalilConnection] = []
        self._session_lock = threading.Lock()
        self._command_lock = threading.Lock()
        """Lock of `_pending_command`, held only while a command passes from the loop to the
        thread."""
        self._pending_command: Command | None = None
        self._wake, self._is_closing = threading.Event(), False
        self._connection_error = ""
        self._measured = ArmMeasurement(0, np.zeros(3), False)
        try:
            connection = self._connect()
            message_connection = None if settings.is_serial else self._connect()
            self._session = GalilSession(connection, message_connection, settings, limits)
            self._session.set_up()
            self._update_measurement(self._session.read())
        except BaseException:
            self._disconnect()
            raise
        self._thread = threading.Thread(target=self._run, name="galil", daemon=True)
        self._thread.start()

    @property
    def off_reason(self) -> str:
        """Reason why the drive went off by itself, in a sentence; empty if it did not."""
        return self._connection_error or self._session.off_reason

    def enable(self) -> None:
        """Switch the motors on, at rest and under the controller's watchdog."""
        if self.settings.is_serial and self.settings.baud < MIN_SERVO_BAUD:
            raise NotReady(
                f"at {self.settings.baud} bits/s a command takes longer than the controller waits "
                f"for the next: connect by network, or at {MIN_SERVO_BAUD} bits/s"
            )
        with self._exclusive_session():
            self._take_command()  # a command from before, which must not move the arm now
            self._update_measurement(self._session.start())

    def set_position(self, q: Floats) -> None:
        """Set the joint position (3,) in rad, rad, mm, at rest and with the drive off."""
        with self._exclusive_session():
            self._session.set_position(q)
            self._update_measurement(self._session.read())

    def is_homed(self) -> bool:
        """Return True if the joint position was set since the reset of the controller."""
        with self._exclusive_session():
            return self._session.is_homed()

    def measure(self) -> ArmMeasurement:
        """Return the last measurement of the joints."""
        return self._measured

    def apply(self, command: Command) -> Floats:
        """Queue a command for the thread, and return the joint rates (3,) that it will apply.

        They are rounded to whole counts per second, and 0 while the drive is off. The thread drops
        a command whose deadline has passed.
        """
        with self._command_lock:
            pending = self._pending_command
            if pending is None or pending.enabled:  # nothing replaces a switch-off
                self._pending_command = command
        self._wake.set()
        if not (command.enabled and self._measured.enabled):
            return np.zeros(3)
        return self._session.in_counts_per_s(command.rates) / np.array(self.settings.counts)

    def close(self) -> None:
        """Stop the arm, switch its motors off and disconnect."""
        self._is_closing = True
        self._wake.set()
        self._thread.join()
        if self._session.is_active:  # otherwise the motors are off or belong to another host
            try:
                self._session.switch_off()
            except RcmServoError as error:
                self._connection_error = self._connection_error or str(error)
        self._disconnect()

    def _connect(self) -> GalilConnection:
        settings, timeout = self.settings, self.settings.reply_timeout
        if settings.is_serial:
            stream = SerialStream(settings.address, settings.baud, timeout)
        else:
            stream = TcpStream(settings.address, settings.port, timeout)
        self._connections.append(GalilConnection(stream, timeout))
        return self._connections[-1]

    def _run(self) -> None:
        """Exchange commands and data records until the arm is closed or the controller is lost."""
        request_urgent_priority()
        while not self._is_closing:
            self._wake.wait(POLL_PERIOD_S)
            self._wake.clear()
            with self._session_lock:
                try:
                    self._exchange()
                except RcmServoError as error:
                    self._connection_error = str(error)
                    self._disconnect()
                    return

    def _exchange(self) -> None:
        """Execute the pending command, if any, and read the arm."""
        command, session = self._take_command(), self._session
        if command is not None and session.is_active:
            if not command.enabled:
                session.switch_off()
            elif time.monotonic_ns() <= command.deadline:
                self._update_measurement(session.exchange(command.rates))
                return
        self._update_measurement(session.read())

    def _take_command(self) -> Command | None:
        """Return the pending command and clear it."""
        with self._command_lock:
            command, self._pending_command = self._pending_command, None
            return command

    def _update_measurement(self, reading: ArmReading) -> None:
        """Store a reading as the last measurement, whose time never decreases."""
        time_ns = max(round(1e9 * reading.time), self._measured.time)
        self._measured = ArmMeasurement(time_ns, reading.q, reading.all_on)

    @contextlib.contextmanager
    def _exclusive_session(self) -> Generator[None]:
        """Keep the thread from using the session; raise `NotReady` if the controller is lost."""
        with self._session_lock:
            if not self._thread.is_alive():
                error = self._connection_error or "the controller is lost"
                raise NotReady(f"{error}; connect again")
            yield

    def _disconnect(self) -> None:
        for connection in self._connections:
            connection.close()
