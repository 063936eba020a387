"""Emulated CRTK arm for any client, with simulated joints behind it.

CRTK (collaborative robotics toolkit) is a convention for topics and states of surgical robots in
ROS. The arm has the six joints of a patient-side manipulator of the dVRK (da Vinci research kit),
with their names and rules:

- It moves only while it is ENABLED and homed.
- A command with a position beyond a limit is refused as a whole, with a warning.
- The names in a command are empty, the joints' names or their numbers.

Three rules differ from the dVRK:

- The arm starts DISABLED.
- The first client that moves the arm controls it until it is disabled. Others get warnings.
- The arm stops when this client falls silent.

    DISABLED ─ enable ─► ENABLED ─ pause ─► PAUSED ─ resume ─► ENABLED
       ▲  └──── disable ◄──┴──────────────────┘
       └ clear_fault ─ FAULT ◄─ fault

Source: dvrk_pybullet and dvrk_simulator_base of jhu-dvrk, from which the texts come.
"""

from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from rcmservo.geometry.kinematics import JointLimits
from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.messages import (
    JointState,
    MessageT,
    OperatingState,
    StringStamped,
    Topic,
    Transport,
)
from rcmservo.interfaces import Floats

JOINT_NAMES = "yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"
JOINT_NUMBERS = tuple(str(i) for i in range(len(JOINT_NAMES)))
WRIST_LIMITS = 4.5, 1.4, 1.4
"""Limits (rad) of the last three joints, to either side."""
LIMIT_TOLERANCE = 1e-9
"""Distance (rad, m) beyond a limit that is rounding."""
STEP_NS = 1_000_000
"""Step of the joints' motion in ns."""
REPORT_PERIOD_NS = 10_000_000
"""Period of the joint reports."""
COMMAND_TIMEOUT_NS = 80_000_000
"""Age of the last position command at which the arm stops."""
MAX_CATCH_UP_NS = 500_000_000
"""Time that one update makes up for after a delay of this program."""
MAX_STATE_COMMAND_AGE_NS = 1_000_000_000
"""Age above which a state command is refused."""
MAX_MOTION_AGE_NS = 200_000_000
"""Age above which a position command is refused."""
STOPPING_COMMANDS = "disable", "pause", "fault"
"""State commands that are accepted at any age."""
STAMP_REQUIRED_NS = 2_000_000_000
"""Time after the start in which a state command needs a stamp: an "enable" without one may be an
old latched message."""
JOINT_LAG_S = 0.05
"""Time constant of the joints' approach to the commanded position."""
MAX_RATES = np.array([1.5, 1.5, 150.0])
"""Largest joint rates in rad/s, rad/s, mm/s."""
SIGNS = np.ones(3)
"""Directions of the joints: those of the mechanism."""


class RateJoints(Protocol):
    """Three joints with velocity drives and brakes."""

    def step(self, rates: Floats, on: bool, time: int) -> Floats:
        """Advance to a time and return the joint position (3,) in rad, rad, mm.

        Parameters
        ----------
        rates : ndarray, shape (3,)
            Joint rates in rad/s, rad/s, mm/s.
        on : bool
            False to hold the joints with the brakes.
        time : int
            Time in ns.
        """
        ...


class CrtkDevice:
    """Emulated arm. `update` does all work that is due.

    Parameters
    ----------
    joints : RateJoints
        Joints that it moves.
    limits : JointLimits
        Limits of the first three joints.
    transport : Transport
        Transport of its topics.
    namespace : str
        Namespace of its topics.
    now : int
        Present time in ns.
    calendar_now : callable
        Function that returns the calendar time in ns.
    """

    def __init__(
        self,
        joints: RateJoints,
        limits: JointLimits,
        transport: Transport,
        namespace: str,
        now: int,
        calendar_now: Callable[[], int],
    ) -> None:
        self.state, self.homed = "DISABLED", True
        self._joints, self._transport, self._calendar_now = joints, transport, calendar_now
        self._namespace = namespace
        lower, upper = (messages.to_rad_m(q, SIGNS) for q in limits.arrays)
        self._lower = np.array([*lower, *(-limit for limit in WRIST_LIMITS)]) - LIMIT_TOLERANCE
        self._upper = np.array([*upper, *WRIST_LIMITS]) + LIMIT_TOLERANCE
        self._start_time = self._time = now // STEP_NS * STEP_NS
        self._report_time = self._command_time = self._state_stamp = 0
        self._arrival = now
        """Time at which the message in hand was received."""
        self._q, self._wrist = joints.step(np.zeros(3), False, self._time), np.zeros(3)
        self._setpoint: Floats | None = None
        self._writer = ""
        self._pending: deque[tuple[Callable[[Any, str], None], Any, str]] = deque()
        for topic in (messages.MEASURED_JS, messages.SETPOINT_JS, messages.WARNING, messages.ERROR):
            transport.offer(topic.under(namespace))
        self._report_state()
        self._subscribe(messages.SERVO_JP, self.receive_motion)
        self._subscribe(messages.STATE_COMMAND, self.receive_command)

    def update(self, now: int) -> None:
        """Execute the received messages and advance to a time in ns."""
        while self._pending:
            handler, message, writer = self._pending.popleft()
            self._arrival = now
            handler(message, writer)
        self._time = max(self._time, now // STEP_NS * STEP_NS - MAX_CATCH_UP_NS)
        while self._time + STEP_NS <= now:
            self._time += STEP_NS
            self._step()
        if now - self._report_time >= REPORT_PERIOD_NS:
            self._report_time = now // REPORT_PERIOD_NS * REPORT_PERIOD_NS
            self._report_joints()

    def receive_motion(self, message: JointState, writer: str) -> None:
        """Accept a position command, or refuse it with a warning."""
        position = self._in_joint_order(message)
        age = self._calendar_now() - message.stamp
        if self.state != "ENABLED" or not self.homed:
            self._warn(f"rejected servo_jp: the arm is {self.state}, homed: {self.homed}")
        elif self._writer not in ("", writer):
            self._warn("rejected servo_jp: another client controls this arm until it is disabled")
        elif message.stamp and not abs(age) <= MAX_MOTION_AGE_NS:
            self._warn(f"rejected servo_jp: it is {age * 1e-9:.3f} s old")
        elif position is None:
            names = ", ".join(JOINT_NAMES)
            self._warn(f"rejected servo_jp: expected six joints, named {names} or unnamed")
        elif not bool(((position >= self._lower) & (position <= self._upper)).all()):
            self._warn("rejected servo_jp: a joint would be beyond its limit")
        else:
            self._writer, self._setpoint = writer, position
            self._command_time = self._arrival - (max(age, 0) if message.stamp else 0)

    def receive_command(self, message: StringStamped, writer: str) -> None:
        """Execute a state command, or refuse it with a warning."""
        command = message.string.strip().lower()
        age = self._calendar_now() - message.stamp
        has_just_started = self._time - self._start_time < STAMP_REQUIRED_NS
        is_old = not abs(age) <= MAX_STATE_COMMAND_AGE_NS if message.stamp else has_just_started
        if is_old and command not in STOPPING_COMMANDS:
            self._warn(f"rejected {command}: it is old, or has no stamp soon after the start")
            return
        match command, self.state:
            case ("enable", "DISABLED" | "ENABLED") | ("resume", "PAUSED" | "ENABLED"):
                self._change_state("ENABLED")
            case "disable", "DISABLED" | "ENABLED" | "PAUSED":
                self._change_state("DISABLED")
            case "pause", "ENABLED" | "PAUSED":
                self._change_state("PAUSED")
            case "home" | "unhome", "DISABLED" | "ENABLED" | "PAUSED":
                self.homed = command == "home"
                self._change_state(self.state)
            case "fault", _:
                self._send_text(messages.ERROR, "a fault was requested")
                self._change_state("FAULT")
            case "clear_fault" | "reset", "FAULT":
                self._change_state("DISABLED")
            case _:
                self._warn(f"rejected {command}: the arm is {self.state}")

    def _subscribe(self, topic: Topic[MessageT], handler: Callable[[MessageT, str], None]) -> None:
        """Queue the messages on a topic for `update`."""

        def enqueue(message: MessageT, writer: str) -> None:
            self._pending.append((handler, message, writer))

        self._transport.subscribe(topic.under(self._namespace), enqueue)

    def _in_joint_order(self, message: JointState) -> Floats | None:
        """Return the six positions in the order of the joints, None if they are invalid."""
        position = np.array(message.position, float)
        if len(position) != len(JOINT_NAMES) or not np.isfinite(position).all():
            return None
        if not message.name:
            return position
        for names in (JOINT_NAMES, JOINT_NUMBERS):
            if sorted(message.name) == sorted(names):
                return position[[message.name.index(name) for name in names]]
        return None

    def _change_state(self, state: str) -> None:
        """Enter a state and report it. The controlling writer changes only when the arm is off."""
        if state != "ENABLED" or not self.homed:
            self._setpoint = None
        if state in ("DISABLED", "FAULT"):
            self._writer = ""
        self.state = state
        self._report_state()

    def _step(self) -> None:
        """Move the joints towards the setpoint for one step, or hold them without a setpoint."""
        if self._setpoint is not None and self._time - self._command_time > COMMAND_TIMEOUT_NS:
            self._setpoint = None
            self._warn("no further position command arrived, and the arm stopped")
        rates = np.zeros(3)
        if self._setpoint is not None:
            error = messages.to_rad_mm(tuple(self._setpoint[:3].tolist()), SIGNS) - self._q
            rates = np.clip(error / JOINT_LAG_S, -MAX_RATES, MAX_RATES)
            self._wrist += (self._setpoint[3:] - self._wrist) * (STEP_NS * 1e-9 / JOINT_LAG_S)
        self._q = self._joints.step(rates, self._setpoint is not None, self._time)

    def _report_joints(self) -> None:
        measured = (*messages.to_rad_m(self._q, SIGNS), *self._wrist.tolist())
        setpoint = measured if self._setpoint is None else tuple(self._setpoint.tolist())
        for topic, position in ((messages.MEASURED_JS, measured), (messages.SETPOINT_JS, setpoint)):
            message = JointState(self._calendar_now(), JOINT_NAMES, position)
            self._transport.publish(topic.under(self._namespace), message)

    def _report_state(self) -> None:
        """Publish the operating state. Its stamps rise even between two reports at one time."""
        self._state_stamp = max(self._calendar_now(), self._state_stamp + 1)
        is_busy = self._setpoint is not None
        message = OperatingState(self._state_stamp, self.state, self.homed, is_busy)
        self._transport.publish(messages.OPERATING_STATE.under(self._namespace), message)

    def _warn(self, text: str) -> None:
        self._send_text(messages.WARNING, text)

    def _send_text(self, topic: Topic[StringStamped], text: str) -> None:
        message = StringStamped(self._calendar_now(), text)
        self._transport.publish(topic.under(self._namespace), message)
