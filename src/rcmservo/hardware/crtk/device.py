"""Emulated CRTK arm for any client, with simulated joints behind it.

It has the six joints of a patient-side manipulator of the dVRK, with their names and rules. A
position beyond a limit is refused as a whole, with a warning. Names are empty, the joints' names or
their numbers. The arm moves only while it is ENABLED and homed. Three rules differ from the dVRK:
the arm starts DISABLED; the first writer that moves it controls it until it is disabled, and others
get warnings; and it stops when its writer falls silent.

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
from rcmservo.hardware.crtk.messages import (
    ERROR,
    MEASURED_JS,
    OPERATING_STATE,
    SERVO_JP,
    SETPOINT_JS,
    STATE_COMMAND,
    WARNING,
    JointState,
    MessageT,
    OperatingState,
    StringStamped,
    Topic,
    Transport,
    to_rad_m,
    to_rad_mm,
)
from rcmservo.interfaces import Floats

JOINT_NAMES = "yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"
JOINT_NUMBERS = tuple(str(i) for i in range(len(JOINT_NAMES)))
WRIST_LIMITS = 4.5, 1.4, 1.4
"""Limits (rad) of the last three joints, to either side."""
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
    """Emulated arm. `turn` does all work that is due.

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
    real : callable
        Calendar time in ns.
    """

    def __init__(
        self,
        joints: RateJoints,
        limits: JointLimits,
        transport: Transport,
        namespace: str,
        now: int,
        real: Callable[[], int],
    ) -> None:
        self.state, self.homed = "DISABLED", True
        self._joints, self._transport, self._real = joints, transport, real
        self._namespace = namespace
        lower, upper = (to_rad_m(q, SIGNS) for q in limits.arrays)
        self._lower = np.array([*lower, *(-limit for limit in WRIST_LIMITS)]) - 1e-9
        self._upper = np.array([*upper, *WRIST_LIMITS]) + 1e-9
        self._start = self._time = now // STEP_NS * STEP_NS
        self._reported = self._commanded = self._state_stamp = 0
        self._received = now
        self._q, self._wrist = joints.step(np.zeros(3), False, self._time), np.zeros(3)
        self._setpoint: Floats | None = None
        self._writer = ""
        self._pending: deque[tuple[Callable[[Any, str], None], Any, str]] = deque()
        for topic in (MEASURED_JS, SETPOINT_JS, WARNING, ERROR):
            transport.offer(topic.under(namespace))
        self._report_state()
        self._subscribe(SERVO_JP, self.receive_motion)
        self._subscribe(STATE_COMMAND, self.receive_command)

    def turn(self, now: int) -> None:
        """Execute the received messages and advance to a time in ns."""
        while self._pending:
            handler, message, writer = self._pending.popleft()
            self._received = now
            handler(message, writer)
        self._time = max(self._time, now // STEP_NS * STEP_NS - MAX_CATCH_UP_NS)
        while self._time + STEP_NS <= now:
            self._time += STEP_NS
            self._step()
        if now - self._reported >= REPORT_PERIOD_NS:
            self._reported = now // REPORT_PERIOD_NS * REPORT_PERIOD_NS
            self._report_joints()

    def receive_motion(self, message: JointState, writer: str) -> None:
        """Accept a position command, or refuse it with a warning."""
        position = self._in_joint_order(message)
        age = self._real() - message.stamp
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
            sent = self._received - (max(age, 0) if message.stamp else 0)
            self._writer, self._setpoint, self._commanded = writer, position, sent

    def receive_command(self, message: StringStamped, writer: str) -> None:
        """Execute a state command, or refuse it with a warning."""
        command = message.string.strip().lower()
        age = self._real() - message.stamp
        just_started = self._time - self._start < STAMP_REQUIRED_NS
        old = not abs(age) <= MAX_STATE_COMMAND_AGE_NS if message.stamp else just_started
        if old and command not in STOPPING_COMMANDS:
            self._warn(f"rejected {command}: it is old, or has no stamp soon after the start")
            return
        match command, self.state:
            case "enable", "DISABLED" | "ENABLED":
                self._change_state("ENABLED")
            case "disable", "DISABLED" | "ENABLED" | "PAUSED":
                self._change_state("DISABLED")
            case "pause", "ENABLED" | "PAUSED":
                self._change_state("PAUSED")
            case "resume", "PAUSED" | "ENABLED":
                self._change_state("ENABLED")
            case "home" | "unhome", "DISABLED" | "ENABLED" | "PAUSED":
                self.homed = command == "home"
                self._change_state(self.state)
            case "fault", _:
                self._send_text(ERROR, "a fault was requested")
                self._change_state("FAULT")
            case "clear_fault" | "reset", "FAULT":
                self._change_state("DISABLED")
            case _:
                self._warn(f"rejected {command}: the arm is {self.state}")

    def _subscribe(self, topic: Topic[MessageT], handler: Callable[[MessageT, str], None]) -> None:
        """Queue the messages on a topic for `turn`."""

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
        if self._setpoint is not None and self._time - self._commanded > COMMAND_TIMEOUT_NS:
            self._setpoint = None
            self._warn("no further position command arrived, and the arm stopped")
        rates = np.zeros(3)
        if self._setpoint is not None:
            error = to_rad_mm(tuple(self._setpoint[:3].tolist()), SIGNS) - self._q
            rates = np.clip(error / JOINT_LAG_S, -MAX_RATES, MAX_RATES)
            self._wrist += (self._setpoint[3:] - self._wrist) * (STEP_NS * 1e-9 / JOINT_LAG_S)
        self._q = self._joints.step(rates, self._setpoint is not None, self._time)

    def _report_joints(self) -> None:
        measured = (*to_rad_m(self._q, SIGNS), *self._wrist.tolist())
        setpoint = measured if self._setpoint is None else tuple(self._setpoint.tolist())
        for topic, position in ((MEASURED_JS, measured), (SETPOINT_JS, setpoint)):
            message = JointState(self._real(), JOINT_NAMES, position)
            self._transport.publish(topic.under(self._namespace), message)

    def _report_state(self) -> None:
        """Publish the operating state. Its stamps rise even between two reports at one time."""
        self._state_stamp = max(self._real(), self._state_stamp + 1)
        busy = self._setpoint is not None
        message = OperatingState(self._state_stamp, self.state, self.homed, busy)
        self._transport.publish(OPERATING_STATE.under(self._namespace), message)

    def _warn(self, text: str) -> None:
        self._send_text(WARNING, text)

    def _send_text(self, topic: Topic[StringStamped], text: str) -> None:
        message = StringStamped(self._real(), text)
        self._transport.publish(topic.under(self._namespace), message)
