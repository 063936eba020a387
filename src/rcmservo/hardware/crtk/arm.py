"""Driver of an arm that speaks CRTK (collaborative robotics toolkit).

Joint rates become position setpoints, or with the setting ``jv`` speeds. Only the arm's own reports
determine whether its drive is on. The driver gives up control when a command is not enabled, when
none arrives before the deadline, when another client moves the arm, or when its reports are
invalid. Then it sends "disable" repeatedly until the arm reports that it is off. Many such arms
have no watchdog. Without further commands they move to their last setpoint, which is close by
(`bounded_lead`), and hold it.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo.errors import shorten_to_line
from rcmservo.geometry.kinematics import JointLimits
from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.bounded_lead import BoundedLead
from rcmservo.hardware.crtk.messages import JointState, StringStamped, Topic, Transport
from rcmservo.hardware.crtk.received_state import (
    ENABLED,
    MAX_JOINT_AGE_NS,
    ReceivedState,
    ReportedJoints,
)
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.crtk.transport import open_transport
from rcmservo.interfaces import ArmMeasurement, Command, Floats
from rcmservo.live.device_protocols import NotReady

FIRST_COMMAND_TIMEOUT_NS = 1_000_000_000
"""Time after enabling in which the first command must arrive."""
CONNECT_TIMEOUT_S = 10.0
"""Time in which all topics must be found."""
DISABLE_PERIOD_NS = 100_000_000
"""Period of "disable" until the arm reports that it is off."""
DISABLE_OVERDUE_NS = 2_000_000_000
"""Time without that report after which the operator is alerted."""
CHECK_PERIOD_S = 0.005
"""Period of the deadline checks."""
FOREIGN_MOTION_PAUSE_NS = 500_000_000
"""Time for which a motion command of another client prevents enabling."""

HOMES_ITSELF = "takes its position from its own homing: home it with its own software"
SETPOINT_JUMPS = "reported a position far from its setpoint, or is beyond a limit"


@dataclass(frozen=True)
class CommandCounts:
    """Numbers of commands by outcome, and of the arm's reports.

    Parameters
    ----------
    sent : int
        Commands sent to the arm.
    withheld : int
        Valid commands that were not sent: the arm reported no recent or no plausible position, or
        the transport failed.
    refused : int
        Void commands: late, repeated, not finite, or with the drive off.
    warned : int
        Warnings of the arm, such as one for each command that it has refused.
    stale : int
        Reports of the arm that were rejected, mostly because they were old.
    """

    sent: int = 0
    withheld: int = 0
    refused: int = 0
    warned: int = 0
    stale: int = 0


class CrtkArm:
    """CRTK arm over a transport. The constructor connects; it does not enable.

    Parameters
    ----------
    settings : CrtkSettings
        Namespace, signs, lead and time limits.
    limits : JointLimits
        Joint limits of the setpoints.
    transport : Transport
        Open transport, which `close` closes.
    now, calendar_now : callable
        Functions that return the present time in ns, of a monotonic clock and as calendar time.

    Raises
    ------
    NotReady
        If a topic has no publisher or subscriber, or the reports are invalid.
    """

    def __init__(
        self,
        settings: CrtkSettings,
        limits: JointLimits,
        transport: Transport,
        now: Callable[[], int] = time.monotonic_ns,
        calendar_now: Callable[[], int] = time.time_ns,
    ) -> None:
        self.settings = settings
        self._name = settings.namespace
        self._transport, self._now, self._calendar_now = transport, now, calendar_now
        self._signs = np.array(settings.signs)
        self._motion_topic = messages.SERVO_JV if settings.jv else messages.SERVO_JP
        self._changed = threading.Condition()
        """Lock of all state, notified after each report."""
        self._received = ReceivedState(settings.namespace)
        self._setpoint = BoundedLead(np.array(settings.max_lead), limits)
        self._wrist: tuple[float, ...] = ()
        self._counts: Counter[str] = Counter()
        self._off_reason = ""
        self._in_control, self._is_suspended = False, False
        self._last_number, self._deadline = -1, 0
        self._switch_off_began = self._disable_sent = self._foreign_motion_time = 0
        """Times of the present switch-off, of the last "disable" and of another client's motion
        command, ns of the monotonic clock."""
        self._is_switching_off = self._is_overdue = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="crtk", daemon=True)
        try:
            self._connect()
        except BaseException:
            self._transport.close()
            raise
        self._thread.start()

    @property
    def off_reason(self) -> str:
        """Reason why the drive went off by itself, in a sentence; empty if it did not."""
        reason = self._received.problem or self._off_reason
        if not self._is_overdue:
            return reason
        warning = f"{self._name} does not report that it is off: use its emergency stop"
        return f"{reason}; {warning}" if reason else warning

    def command_counts(self) -> CommandCounts:
        """Return the numbers of commands by outcome so far, and of the arm's reports."""
        received = self._received
        with self._changed:
            return CommandCounts(**self._counts, warned=received.warnings, stale=received.rejected)

    def is_homed(self) -> bool:
        """Return True if the arm reports that it is homed, False if it reports no state.

        Raise `NotReady` if it is not homed, because an operator cannot set its position.
        """
        state = self._received.state
        if state is not None and not state.is_homed:
            raise NotReady(f"{self._name} {HOMES_ITSELF}")
        return state is not None

    def set_position(self, q: Floats) -> None:
        """Raise `NotReady`: the arm homes itself."""
        raise NotReady(f"{self._name} {HOMES_ITSELF}")

    def enable(self) -> None:
        """Switch the drive on, at rest. If that fails, switch it off again."""
        with self._changed:
            self._require_ready()
            self._off_reason, self._is_suspended = "", False
            self._is_switching_off = self._is_overdue = False
            received = self._received
            try:
                if received.state is not None and received.state.state == ENABLED:
                    self._send_state_command("disable")
                    self._wait_for(lambda: not received.is_powered, "does not switch off")
                self._send_state_command("enable")
                self._wait_for(lambda: received.is_ready, "does not switch on")
                joints = self._wait_for_joints()
            except BaseException:
                self._give_up_control("")
                raise
            now = self._now()
            self._setpoint.start(messages.to_rad_mm(joints.position, self._signs), now)
            self._wrist = joints.position[3:]
            self._in_control, self._last_number = True, -1
            self._deadline = now + FIRST_COMMAND_TIMEOUT_NS

    def measure(self) -> ArmMeasurement:
        """Return the last reported joint position and drive state."""
        joints = self._received.joints
        assert joints is not None
        q = messages.to_rad_mm(joints.position, self._signs)
        return ArmMeasurement(joints.time, q, self._received.is_ready)

    def apply(self, command: Command) -> Floats:
        """Send a command; return the joint rates (3,) that the setpoint really has."""
        with self._changed:
            if not command.enabled:
                if self._in_control:
                    self._give_up_control("")
                return np.zeros(3)
            if not self._is_valid(command):
                self._counts["refused"] += 1
                return np.zeros(3)
            self._last_number, self._deadline = command.number, command.deadline
            rates = self._send_rates(command.rates)
            self._counts["withheld" if rates is None else "sent"] += 1
            return np.zeros(3) if rates is None else rates

    @property
    def is_rate_controlled(self) -> bool:
        """True if the arm gets speeds instead of positions."""
        return self.settings.jv

    def suspend_communication(self) -> None:
        """Send nothing, as if this program had died, until the arm is switched off or on."""
        with self._changed:
            self._is_suspended = True

    def close(self) -> None:
        """Switch the arm off if this client controls it, and disconnect."""
        with self._changed:
            if self._in_control:
                self._give_up_control("")
            if self._is_switching_off:
                timeout = self.settings.reply_timeout
                is_off = self._changed.wait_for(lambda: not self._received.is_powered, timeout)
                self._is_overdue = not is_off
        self._closing.set()
        self._thread.join()
        self._transport.close()

    @property
    def _last_warning(self) -> str:
        """The arm's last warning, as the end of a sentence."""
        warning = self._received.warning
        return f"; its last warning: {shorten_to_line(warning)}" if warning else ""

    def _connect(self) -> None:
        """Subscribe to the arm's topics and wait until both sides have found each other."""
        motion_topic, state_topic = self._motion_topic, messages.STATE_COMMAND
        outgoing: list[Topic[Any]] = [
            topic.under(self._name) for topic in (motion_topic, state_topic)
        ]
        for topic in outgoing:
            self._transport.offer(topic)
        self._transport.subscribe(messages.MEASURED_JS.under(self._name), self._receive_joints)
        self._transport.subscribe(messages.OPERATING_STATE.under(self._name), self._receive_state)
        for topic in (messages.WARNING, messages.ERROR):
            self._transport.subscribe(topic.under(self._name), self._receive_warning)
        with self._changed:
            self._changed.wait_for(lambda: not self._describe_missing(outgoing), CONNECT_TIMEOUT_S)
            missing = self._describe_missing(outgoing)
            if missing:
                ros2 = f"ROS 2, domain {self.settings.domain} on {self.settings.interface}"
                network = ros2 if self.settings.ros == 2 else "ROS 1"
                raise NotReady(self._received.problem or f"{missing} by {network}")
        for topic in messages.MOTION_TOPICS:
            self._transport.subscribe(topic.under(self._name), self._receive_foreign_motion)

    def _describe_missing(self, outgoing: list[Topic[Any]]) -> str:
        """Return a phrase about the first topic without a partner, empty if there is none."""
        unheard = [topic.name for topic in outgoing if not self._transport.count_listeners(topic)]
        return self._received.missing or (f"nothing subscribes to {unheard[0]}" if unheard else "")

    def _receive_joints(self, message: JointState, writer: str) -> None:
        with self._changed:
            self._received.receive_joints(message, writer, self._now(), self._calendar_now())
            self._check_reports()

    def _receive_state(self, message: messages.OperatingState, writer: str) -> None:
        with self._changed:
            self._received.receive_state(message, writer, self._calendar_now())
            if self._in_control and not self._received.is_ready:
                if self._received.is_powered:
                    reason = f"{self._name} is no longer homed, and it was switched off"
                    self._give_up_control(reason)
                else:
                    self._in_control = False
                    cause = f"{self._name} changed to {message.state} by itself"
                    self._off_reason = cause + self._last_warning
            self._check_reports()

    def _receive_warning(self, message: StringStamped, writer: str) -> None:
        with self._changed:
            self._received.receive_warning(message, writer)

    def _receive_foreign_motion(self, message: messages.RosMessage, writer: str) -> None:
        """Give up control, because another client sends motion commands."""
        with self._changed:
            self._foreign_motion_time = self._now()
            if self._in_control:
                cause = f"another client sends motion commands to {self._name}"
                self._give_up_control(f"{cause}, and it was switched off")

    def _check_reports(self) -> None:
        """Give up control if the arm's reports are invalid, and wake waiting threads."""
        if self._in_control and self._received.problem:
            self._give_up_control(self._received.problem)
        self._changed.notify_all()

    def _require_ready(self) -> None:
        """Raise `NotReady` if the arm cannot be enabled."""
        received = self._received
        if received.problem:
            raise NotReady(received.problem)
        if self._closing.is_set():
            raise NotReady(f"{self._name} was disconnected: connect again")
        self._wait_for_joints()
        state = received.state
        if state is None or not state.is_homed:
            raise NotReady(f"{self._name} is not homed: home it with its own software")
        if state.state not in ("DISABLED", ENABLED):
            problem = f"{self._name} is {state.state}: an operator must clear that first"
            raise NotReady(problem + self._last_warning)
        since_foreign_motion = self._now() - self._foreign_motion_time
        if self._foreign_motion_time and since_foreign_motion < FOREIGN_MOTION_PAUSE_NS:
            raise NotReady(f"another client moves {self._name}: end that first")

    def _recent_joints(self) -> ReportedJoints | None:
        """Return the reported joints if they are recent enough for motion."""
        joints = self._received.joints
        is_recent = joints is not None and self._now() - joints.time <= MAX_JOINT_AGE_NS
        return joints if is_recent else None

    def _wait_for_joints(self) -> ReportedJoints:
        """Wait for a recent joint position, or raise `NotReady`."""
        stamp_problem = self._received.invalid_stamps.get(messages.MEASURED_JS.name)
        problem = "does not report its position" + (f": {stamp_problem}" if stamp_problem else "")
        self._wait_for(lambda: self._recent_joints() is not None, problem)
        joints = self._received.joints
        assert joints is not None
        return joints

    def _wait_for(self, condition: Callable[[], bool], problem: str) -> None:
        """Wait for a condition, or raise `NotReady` with the problem."""
        if not self._changed.wait_for(condition, self.settings.reply_timeout):
            raise NotReady(f"{self._name} {problem}{self._last_warning}")

    def _is_valid(self, command: Command) -> bool:
        return (
            self._in_control
            and not self._is_suspended
            and command.number > self._last_number
            and self._now() <= min(command.deadline, self._deadline)
            and command.rates.shape == (3,)
            and bool(np.isfinite(command.rates).all())
        )

    def _send_rates(self, rates: Floats) -> Floats | None:
        """Send joint rates as speeds or as a setpoint; return the real rates, None if not sent."""
        joints = self._recent_joints()
        if self.settings.jv:
            is_sent = self._send_speeds(np.zeros(3) if joints is None else rates)
            return rates.copy() if is_sent and joints is not None else None
        if joints is None:
            return None
        now, stamp = self._now(), self._calendar_now()
        measured = messages.to_rad_mm(joints.position, self._signs)
        step = self._setpoint.step(rates, measured, now)
        if step is None:
            self._give_up_control(f"{self._name} {SETPOINT_JUMPS}, and it was switched off")
            return None
        setpoint, real_rates = step
        position = (*messages.to_rad_m(setpoint, self._signs), *self._wrist)
        return real_rates if self._publish(JointState(stamp, joints.name, position)) else None

    def _send_speeds(self, rates: Floats) -> bool:
        """Send joint rates as speeds; return True if they were sent."""
        joints = self._received.joints
        names = () if joints is None else joints.name
        velocity = (*messages.to_rad_m(rates, self._signs), *(0.0 for _ in self._wrist))
        return self._publish(JointState(self._calendar_now(), names, velocity=velocity))

    def _publish(self, message: JointState) -> bool:
        return self._transport.publish(self._motion_topic.under(self._name), message)

    def _send_state_command(self, command: str) -> None:
        message = StringStamped(self._calendar_now(), command)
        self._transport.publish(messages.STATE_COMMAND.under(self._name), message)

    def _give_up_control(self, reason: str) -> None:
        """End this client's control and switch the arm off; with ``jv`` send zero speed first."""
        if self._in_control and self.settings.jv:
            self._send_speeds(np.zeros(3))
        self._in_control, self._is_suspended = False, False
        self._off_reason = reason or self._off_reason
        self._is_switching_off, self._switch_off_began = True, self._now()
        self._send_disable()

    def _send_disable(self) -> None:
        self._disable_sent = self._now()
        self._send_state_command("disable")

    def _watch(self) -> None:
        while not self._closing.wait(CHECK_PERIOD_S):
            with self._changed:
                self.check_deadlines()

    def check_deadlines(self) -> None:
        """Switch the arm off after the deadline, and repeat "disable" until it is off."""
        now = self._now()
        if self._is_suspended:
            return
        if self._in_control and not now <= self._deadline:
            self._give_up_control(f"no command came in time, and {self._name} was switched off")
        elif self._is_switching_off and now - self._disable_sent >= DISABLE_PERIOD_NS:
            self._is_switching_off = self._received.is_powered
            is_late = now - self._switch_off_began >= DISABLE_OVERDUE_NS
            self._is_overdue = self._is_switching_off and is_late
            if self._is_switching_off:
                self._send_disable()


def open_crtk_arm(settings: CrtkSettings, limits: JointLimits) -> CrtkArm:
    """Connect to the arm over the transport in its settings."""
    return CrtkArm(settings, limits, open_transport(settings))
