"""Use of a Galil controller by an arm's driver, from set-up to switch-off.

    set up        require that no other host or program uses the arm; switch the motors off; send
                  settings and watchdog program
    set_position  set the joint position; an operator does it after each reset of the controller
    start         send settings and program again; start the program and switch the motors on; the
                  program begins a jog at zero speed
    exchange      send speeds and the watchdog's count, and read the data record
    switch off    decelerate the axes, then switch the motors off

Each step waits for all replies. Sources: command reference; docs/galil.md lists what was tested.
"""

import contextlib
from dataclasses import dataclass

import numpy as np

from rcmservo.errors import RcmServoError, quote_value, require
from rcmservo.geometry.kinematics import JointLimits
from rcmservo.hardware.galil import stop_reasons, watchdog_program
from rcmservo.hardware.galil.connection import CommandRejected, GalilConnection
from rcmservo.hardware.galil.data_record import AXIS_LETTERS, BLOCK_SIZES, MOTOR_OFF, DataRecord
from rcmservo.hardware.galil.sample_clock import SAMPLE_TIME_PER_TM_S, SampleClock
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.hardware.galil.watchdog_program import THREAD_COUNT, WATCHDOG_THREAD
from rcmservo.interfaces import Floats
from rcmservo.live.device_protocols import NotReady

HOMED_VARIABLE = "rcmhome"
"""Controller variable with the checksum of axes and counts for which an operator has set the
position. A reset deletes it."""

SESSION_VARIABLE = "rcmsess"
"""Controller variable with the number of the newest session."""

COUNTS_PER_SESSION = 1_000_000
"""Distance between the first watchdog counts of two sessions."""
SESSION_MODULUS = 2000
"""Sessions after which the numbers restart."""

REQUIRED_TM = 1000.0
"""Required value of TM, and the value of a controller that does not report it."""

PROGRAM_CHECK_PERIOD_S = 0.05
"""Period of the checks that the watchdog program runs."""
MOTION_START_TIMEOUT_S = 0.02
"""Time from the start of the watchdog program to the start of the axes."""
SWITCH_OFF_TIMEOUT_S = 0.2
"""Time, in addition to the deceleration, in which the motors must go off."""


@dataclass(frozen=True, eq=False)
class ArmReading:
    """State of the arm from one data record.

    Parameters
    ----------
    q : Floats
        Joint position (3,) in rad, rad, mm.
    all_on : bool
        True if all three motors are on.
    all_off : bool
        True if all three motors are off.
    time : float
        Time of the measurement, s on the connection's clock.
    record : DataRecord
        The complete record.
    """

    q: Floats
    all_on: bool
    all_off: bool
    time: float
    record: DataRecord


class GalilSession:
    """Exclusive use of a controller's three axes by one arm.

    Parameters
    ----------
    connection : GalilConnection
        Connection for commands.
    message_connection : GalilConnection or None
        Connection that receives unsolicited messages; None over a serial port.
    settings : GalilSettings
        Axes and scales.
    limits : JointLimits
        Joint limits, which become the soft limits of the axes.
    """

    def __init__(
        self,
        connection: GalilConnection,
        message_connection: GalilConnection | None,
        settings: GalilSettings,
        limits: JointLimits,
    ) -> None:
        self.settings, self.limits = settings, limits
        self.off_reason = ""
        """Reason why the controller switched the motors off, in a sentence; empty if it did not."""
        self.last_message = ""
        """Last unsolicited message since the motors were enabled; empty if there was none."""
        self.is_active = False
        """True if this session has switched motors on that are not known to be off again."""
        self._connection, self._message_connection = connection, message_connection
        self._indices = [AXIS_LETTERS.index(axis) for axis in settings.axes]
        self._axis_count = self._watchdog_count = 0
        self._program_check_time = 0.0
        self._sent_speeds, self._top_speeds = np.zeros(3), np.zeros(3)
        self._clock = SampleClock(REQUIRED_TM * SAMPLE_TIME_PER_TM_S)

    def set_up(self) -> None:
        """Identify the controller and prepare it, with the motors off."""
        self._connection.execute("CW 1")
        self._axis_count = self._read_axis_count()
        self._require_free()
        self._require_sample_time()
        self._prepare()

    def _prepare(self) -> None:
        """Switch the motors off and send all settings and the program.

        They replace those of earlier hosts.
        """
        if self._message_connection is not None:
            self._message_connection.execute("CF I")
        self._connection.execute(f"MO {self.settings.axes}")
        self._configure()
        self._connection.execute(*self._speed_commands(np.zeros(3)))
        self._download_watchdog()

    def _require_sample_time(self) -> None:
        """Raise `NotReady` unless TM has the value that timeout and sample clock assume."""
        tm = self._connection.read_variable("_TM") or REQUIRED_TM
        if tm != REQUIRED_TM:
            raise NotReady(
                f"TM is {tm:g} on the controller: set it to {REQUIRED_TM:g}, the value on which "
                "the timeout of the watchdog program is based"
            )

    def _download_watchdog(self) -> None:
        axes = self.settings.axes
        try:
            timeout_ms = round(1e3 * self.settings.command_timeout)
            lines = watchdog_program.program_lines(axes, timeout_ms)
            self._connection.download_program(lines)
        except CommandRejected:
            self._connection.execute("AB 1")  # it may have executed lines as commands
            self._connection.execute(f"MO {axes}")
            raise

    def _require_free(self) -> None:
        """Raise `NotReady` if another host or a program uses the controller."""
        axes = self.settings.axes
        query = f"MG {','.join(f'_XQ{thread}' for thread in range(THREAD_COUNT))}"
        running_lines = self._connection.read_numbers(query)  # -1 for a thread that does not run
        if len(running_lines) != THREAD_COUNT:
            expected = f"{query} must return {THREAD_COUNT} numbers"
            raise NotReady(f"{expected}, got {quote_value(running_lines)}")
        if running_lines[WATCHDOG_THREAD] >= 0.0:
            raise NotReady("another host uses the arm: end it there, or end its program with HX")
        for thread, line in enumerate(running_lines):
            if line >= 0.0:
                raise NotReady(
                    f"a program runs on the controller, in thread {thread}: it must end before the "
                    "watchdog program can replace it"
                )
        if any(self._connection.read_number(f"_BG{axis}") for axis in axes):
            raise NotReady(f"the axes {axes} move: the host that moves them must stop them first")

    def is_homed(self) -> bool:
        """Return True if an operator has set the position since the controller's reset.

        The position must have been set with the present counts and axes: with other scales the same
        counts are another position.
        """
        return self._connection.read_variable(HOMED_VARIABLE) == self.settings.scale_checksum

    def set_position(self, q: Floats) -> None:
        """Set the joint position (3,) in rad, rad, mm, at rest and with the drive off."""
        require(bool(np.isfinite(q).all()), "q", q.tolist(), "three numbers")
        counts = np.round(q * np.array(self.settings.counts))
        self._connection.execute(*self._axis_commands("DP", counts))
        self._connection.execute(f"{HOMED_VARIABLE}={self.settings.scale_checksum}")

    def start(self) -> ArmReading:
        """Start the watchdog program, switch the motors on, at rest, and read the state of the arm.

        Raises
        ------
        NotReady
            If the position is not set, another host uses the arm, an amplifier has an error, or the
            axes do not begin. The motors are off then.
        """
        if not self.is_homed():
            raise NotReady(
                "the arm's position is not set since the controller was reset or its counts and "
                "axes were changed: bring the arm to a mark and define its position"
            )
        if self.is_active:
            self.switch_off()
        self._require_free()
        self._require_sample_time()
        errors = stop_reasons.read_amplifier_errors(self._connection, self.settings.axes)
        if errors:
            raise NotReady(f"the amplifiers are not ready: {', '.join(errors)}")
        axes, connection = self.settings.axes, self._connection
        if not all(connection.read_number(f"_MO{axis}") for axis in axes):
            raise NotReady("another host has switched the motors on: end its use of the arm first")
        self._prepare()
        session_number = int(connection.read_variable(SESSION_VARIABLE)) % SESSION_MODULUS + 1
        self._watchdog_count = session_number * COUNTS_PER_SESSION
        self.off_reason, self.last_message = "", ""
        self._top_speeds = np.zeros(3)
        connection.execute(
            f"{SESSION_VARIABLE}={session_number}", f"hb={self._watchdog_count}", "TC"
        )
        self.is_active, self._program_check_time = True, connection.now()
        try:
            # One line: a delayed SH on a line of its own could arrive after the program has ended.
            connection.execute(f"XQ #RCMWD,{WATCHDOG_THREAD}", f"SH {axes}")
            self._wait_for_motion()
            self._watchdog_count += 1
            # One line restarts the timeout and reads: a reading of its own would cost some of it.
            return self.read(f"hb={self._watchdog_count}")
        except RcmServoError:
            with contextlib.suppress(RcmServoError):
                self.switch_off()
            raise

    def _wait_for_motion(self) -> None:
        """Wait until the watchdog program has begun the jog."""
        deadline = self._connection.now() + MOTION_START_TIMEOUT_S
        while not all(self._connection.read_number(f"_BG{axis}") for axis in self.settings.axes):
            if self._connection.now() > deadline:
                cause = stop_reasons.last_command_error(self._connection) or self._stop_cause(
                    self.read()
                )
                raise NotReady(f"the axes do not begin: {self._explain(cause)}")

    def read(self, *commands: str) -> ArmReading:
        """Send some commands and read the state of the arm."""
        requested = self._connection.now()
        record = self._connection.read_data_record(self._axis_count, *commands)
        sample = int(record.general["sample"])
        time = self._clock.time_of(sample, requested, self._connection.now())
        self._read_messages()
        axes = record.axes[self._indices]
        q = axes["position"] / np.array(self.settings.counts)
        is_off = axes["status"] & MOTOR_OFF != 0
        reading = ArmReading(q, not is_off.any(), bool(is_off.all()), time, record)
        self._check_motors(reading)
        return reading

    def _read_messages(self) -> None:
        """Store the last unsolicited message.

        Unread messages would fill the controller's buffers.
        """
        if self._message_connection is not None:
            self.last_message = [self.last_message, *self._message_connection.read_messages()][-1]

    def exchange(self, rates: Floats) -> ArmReading:
        """Jog with these joint rates (3,) and read the state of the arm.

        The method first compares the controller's speeds with those sent last, to detect another
        host before overwriting its speeds. _JG reports sizes only, so speeds of the same size from
        another host stay undetected, for 10 ms. If the controller has switched a motor off, the
        method sends no speeds.
        """
        if self.off_reason:
            return self.read()
        if self.is_active and self._has_foreign_speeds():
            self.switch_off()
            self.off_reason = watchdog_program.STOP_CAUSES[watchdog_program.FOREIGN_SPEED]
            return self.read()
        self._watchdog_count += 1
        speeds = self._speed_commands(self.in_counts_per_s(rates))
        return self.read(*speeds, f"hb={self._watchdog_count}")

    def _has_foreign_speeds(self) -> bool:
        """Return True if the controller's speeds differ from those sent last."""
        query = "MG " + ",".join(f"_JG{axis}" for axis in self.settings.axes)
        return self._connection.read_numbers(query) != np.abs(self._sent_speeds).tolist()

    def in_counts_per_s(self, rates: Floats) -> Floats:
        """Convert joint rates (3,) to counts/s, rounded towards zero to even numbers for JG."""
        return 2.0 * np.trunc(rates * np.array(self.settings.counts) / 2.0)

    def switch_off(self) -> None:
        """Stop the axes and switch the motors off.

        The watchdog program does it. If it does not in time, an abort does.
        """
        axes, connection = self.settings.axes, self._connection
        connection.execute(f"ST {axes}", "hb=-1")
        stopping_time = self.settings.stopping_time(self._top_speeds)
        deadline = connection.now() + stopping_time + SWITCH_OFF_TIMEOUT_S
        while not all(connection.read_number(f"_MO{axis}") for axis in axes):
            if connection.now() > deadline:
                connection.execute(f"HX {WATCHDOG_THREAD}", "AB 1")
                connection.execute(f"MO {axes}")
        self.is_active = False

    def _read_axis_count(self) -> int:
        """Return the number of axes, or raise `NotReady` if it is no suitable DMC-40x0."""
        reply = self._connection.execute("QZ")[0]
        try:
            count, *block_sizes = (int(part) for part in reply.split(","))
        except ValueError:
            count, block_sizes = 0, []
        if tuple(block_sizes) != BLOCK_SIZES or not max(self._indices) < count <= len(AXIS_LETTERS):
            model = self._connection.execute("\x12\x16")[0]
            expected = f"?, {', '.join(map(str, BLOCK_SIZES))} with axes {self.settings.axes}"
            actual = f"{quote_value(reply)} of {quote_value(model)}"
            raise NotReady(f"QZ of a DMC-40x0 must be {expected}, got {actual}")
        return count

    def _configure(self) -> None:
        """Send the settings of the axes."""
        settings = self.settings
        ends = np.array([self.limits.lower, self.limits.upper]) * np.array(settings.counts)
        lower, upper = np.sort(ends, axis=0).round()
        for name, values in (
            ("AC", settings.to_counts(settings.acceleration)),
            ("DC", settings.to_counts(settings.deceleration)),
            ("SD", settings.to_counts(settings.deceleration)),
            ("ER", settings.to_counts(settings.following_error)),
            ("OE", np.ones(3)),
            ("BL", lower),
            ("FL", upper),
        ):
            self._connection.execute(*self._axis_commands(name, values))

    def _axis_commands(self, name: str, values: Floats) -> list[str]:
        """Return one command per axis that sets a value, truncated to an integer."""
        pairs = zip(self.settings.axes, values, strict=True)
        return [f"{name}{axis}={int(value)}" for axis, value in pairs]

    def _speed_commands(self, counts: Floats) -> list[str]:
        """Return commands that jog with these counts/s (3,) and store them for the watchdog."""
        self._sent_speeds, self._top_speeds = counts, np.maximum(self._top_speeds, np.abs(counts))
        variables = [f"v{axis.lower()}" for axis in self.settings.axes]
        assignments = [f"{name}={int(n)}" for name, n in zip(variables, counts, strict=True)]
        jog_fields = [""] * (max(self._indices) + 1)
        for index, name in zip(self._indices, variables, strict=True):
            jog_fields[index] = name
        return ["up=1", *assignments, "JG " + ",".join(jog_fields), "up=0"]

    def _check_motors(self, reading: ArmReading) -> None:
        """Detect motors that the controller has switched off, and an ended watchdog program.

        If some motors are on without the program, nothing else would stop them.
        """
        if not self.is_active:
            return
        if not reading.all_on:
            self.off_reason = self.off_reason or self._explain(self._stop_cause(reading))
        is_due = self._connection.now() - self._program_check_time > PROGRAM_CHECK_PERIOD_S
        if reading.all_off:
            self.is_active = False
        elif not reading.all_on or is_due:
            self._program_check_time = self._connection.now()
            if self._connection.read_number(f"_XQ{WATCHDOG_THREAD}") < 0.0:
                self.switch_off()
                ended = "the watchdog program on the controller has ended"
                self.off_reason = self.off_reason or ended

    def _stop_cause(self, reading: ArmReading) -> str:
        """Return the reason why the axes are at rest."""
        codes = reading.record.axes[self._indices]["stop"].tolist()
        return stop_reasons.describe_stop(self._connection, self.settings.axes, codes)

    def _explain(self, cause: str) -> str:
        self._read_messages()
        return stop_reasons.append_device_reports(
            cause, self._connection, self.settings.axes, self.last_message
        )
