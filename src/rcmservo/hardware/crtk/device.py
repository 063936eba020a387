"""An arm that speaks CRTK and is not there, for anybody's client, with what moves behind it.

It has the six joints of a patient-side manipulator of the dVRK, their names and its rules:
positions beyond a limit are refused whole with a warning, names are empty or the joints' or their
numbers, and no motion is taken unless it is ENABLED and homed. Three rules are its own. It starts
DISABLED. Whoever moves it first after it was enabled has it until it is disabled; others are
warned. And where its writer falls silent it comes to rest where it is.

    DISABLED ─ enable ─► ENABLED ─ pause ─► PAUSED ─ resume ─► ENABLED
       ▲  └──── disable ◄──┴──────────────────┘
       └ clear_fault ─ FAULT ◄─ fault

Source: dvrk_pybullet and dvrk_simulator_base of jhu-dvrk, whose words these are.
"""

from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from rcmservo.hardware.crtk import messages as m
from rcmservo.hardware.crtk.transport import Transport
from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import JointLimits

NAMES = "yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"
NUMBERS = tuple(str(i) for i in range(len(NAMES)))
WRIST = 4.5, 1.4, 1.4
"""rad that the last three joints turn to either side."""
STEP = 1_000_000
"""ns between two looks at where the arm is to go."""
TOLD = 10_000_000
"""ns between two messages of where it is."""
SILENCE = 80_000_000
"""ns after the last position was sent at which it comes to rest."""
LATE = 500_000_000
"""ns that are made up for after this program was held up."""
OLD = 1_000_000_000
"""ns after which nobody still wants what a state command says,"""
OLD_MOTION = 200_000_000
"""ns, or a position."""
CALMING = "disable", "pause", "fault"
"""State commands that are taken however old they are."""
START = 2_000_000_000
"""ns after the start in which what moves must bear a stamp: an "enable" without one may be an old
one that is told to everybody who comes."""
FOLLOW = 0.05
"""s, the time constant with which the joints go to where they are asked to be."""
SPEED = np.array([1.5, 1.5, 150.0])
"""rad/s, rad/s, mm/s at most."""
SIGNS = np.ones(3)


class RateJoints(Protocol):
    """What moves: three joints with velocity drives, and brakes that hold them at once."""

    def step(self, rates: Floats, on: bool, time: int) -> Floats:
        """Let time pass until `time` ns with these joint rates (3,), or with the brakes on; the
        joints (3,) rad, rad, mm then."""
        ...


class CrtkDevice:
    """The arm; `turn` does all that is due. `real` is the calendar time, ns."""

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
        lower, upper = (m.in_rad_and_m(q, SIGNS) for q in limits.arrays)
        self._lower = np.array([*lower, *(-turn for turn in WRIST)]) - 1e-9
        self._upper = np.array([*upper, *WRIST]) + 1e-9
        self._start = self._time = now // STEP * STEP
        self._told = self._heard = self._stamp = 0
        self._hearing = now
        self._q, self._wrist = joints.step(np.zeros(3), False, self._time), np.zeros(3)
        self._setpoint: Floats | None = None
        self._writer = ""
        self._waiting: deque[tuple[Callable[[Any, str], None], Any, str]] = deque()
        for topic in (m.MEASURED_JS, m.SETPOINT_JS, m.WARNING, m.ERROR):
            transport.offer(topic.under(namespace))
        self._tell_state()
        self._take(m.SERVO_JP, self.hear_motion)
        self._take(m.STATE_COMMAND, self.hear_command)

    def turn(self, now: int) -> None:
        """Hear what has come, and let time pass until `now` ns."""
        while self._waiting:
            hear, said, writer = self._waiting.popleft()
            self._hearing = now
            hear(said, writer)
        self._time = max(self._time, now // STEP * STEP - LATE)
        while self._time + STEP <= now:
            self._time += STEP
            self._step()
        if now - self._told >= TOLD:
            self._told = now // TOLD * TOLD
            self._tell_joints()

    def hear_motion(self, said: m.JointState, writer: str) -> None:
        """Take where it shall be, if that is right."""
        position = self._ordered(said)
        age = self._real() - said.stamp
        if self.state != "ENABLED" or not self.homed:
            self._warn(f"rejected servo_jp: the arm is {self.state}, homed: {self.homed}")
        elif self._writer not in ("", writer):
            self._warn("rejected servo_jp: somebody else moves this arm until it is disabled")
        elif said.stamp and not abs(age) <= OLD_MOTION:
            self._warn(f"rejected servo_jp: it is {age * 1e-9:.3f} s old")
        elif position is None:
            self._warn(f"rejected servo_jp: six joints are wanted, named {', '.join(NAMES)} or not")
        elif not bool(((position >= self._lower) & (position <= self._upper)).all()):
            self._warn("rejected servo_jp: a joint would be beyond its limit")
        else:
            sent = self._hearing - (max(age, 0) if said.stamp else 0)
            self._writer, self._setpoint, self._heard = writer, position, sent

    def hear_command(self, said: m.StringStamped, writer: str) -> None:
        """Take what it shall be, if that is right."""
        word, age = said.string.strip().lower(), self._real() - said.stamp
        early = self._time - self._start < START
        old = not abs(age) <= OLD if said.stamp else early
        if old and word not in CALMING:
            self._warn(f"rejected {word}: it is old, or bears no stamp soon after the start")
            return
        match word, self.state:
            case "enable", "DISABLED" | "ENABLED":
                self._become("ENABLED")
            case "disable", "DISABLED" | "ENABLED" | "PAUSED":
                self._become("DISABLED")
            case "pause", "ENABLED" | "PAUSED":
                self._become("PAUSED")
            case "resume", "PAUSED" | "ENABLED":
                self._become("ENABLED")
            case "home" | "unhome", "DISABLED" | "ENABLED" | "PAUSED":
                self.homed = word == "home"
                self._become(self.state)
            case "fault", _:
                self._say(m.ERROR, "a fault was asked for")
                self._become("FAULT")
            case "clear_fault" | "reset", "FAULT":
                self._become("DISABLED")
            case _:
                self._warn(f"rejected {word}: the arm is {self.state}")

    def _take(self, topic: m.Topic[m.Said], hear: Callable[[m.Said, str], None]) -> None:
        def heard(said: m.Said, writer: str) -> None:
            self._waiting.append((hear, said, writer))

        self._transport.subscribe(topic.under(self._namespace), heard)

    def _ordered(self, said: m.JointState) -> Floats | None:
        """The six positions in the joints' own order; None where they are not that."""
        position = np.array(said.position, float)
        if len(position) != len(NAMES) or not np.isfinite(position).all():
            return None
        if not said.name:
            return position
        for names in (NAMES, NUMBERS):
            if sorted(said.name) == sorted(names):
                return position[[said.name.index(name) for name in names]]
        return None

    def _become(self, state: str) -> None:
        """Be in a state, and tell so. Whoever moves the arm has it until it is off."""
        if state != "ENABLED" or not self.homed:
            self._setpoint = None
        if state in ("DISABLED", "FAULT"):
            self._writer = ""
        self.state = state
        self._tell_state()

    def _step(self) -> None:
        if self._setpoint is not None and self._time - self._heard > SILENCE:
            self._setpoint = None
            self._warn("nothing more was heard of where to go, and the arm stopped")
        rates = np.zeros(3)
        if self._setpoint is not None:
            far = m.in_rad_and_mm(tuple(self._setpoint[:3].tolist()), SIGNS) - self._q
            rates = np.clip(far / FOLLOW, -SPEED, SPEED)
            self._wrist += (self._setpoint[3:] - self._wrist) * (STEP * 1e-9 / FOLLOW)
        self._q = self._joints.step(rates, self._setpoint is not None, self._time)

    def _tell_joints(self) -> None:
        here = (*m.in_rad_and_m(self._q, SIGNS), *self._wrist.tolist())
        wanted = here if self._setpoint is None else tuple(self._setpoint.tolist())
        for topic, position in ((m.MEASURED_JS, here), (m.SETPOINT_JS, wanted)):
            said = m.JointState(self._real(), NAMES, position)
            self._transport.publish(topic.under(self._namespace), said)

    def _tell_state(self) -> None:
        """Stamps of states rise, also where two come at one time."""
        self._stamp = max(self._real(), self._stamp + 1)
        busy = self._setpoint is not None
        said = m.OperatingState(self._stamp, self.state, self.homed, busy)
        self._transport.publish(m.OPERATING_STATE.under(self._namespace), said)

    def _warn(self, words: str) -> None:
        self._say(m.WARNING, words)

    def _say(self, topic: m.Topic[m.StringStamped], words: str) -> None:
        said = m.StringStamped(self._real(), words)
        self._transport.publish(topic.under(self._namespace), said)
