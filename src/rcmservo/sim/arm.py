"""The simulated arm: a MuJoCo model with velocity drives, and the faults of real drives.

A command reaches a joint after a delay and through a first-order lag. A command inside the deadband
moves nothing, and a motor may make more or less of a rate than was asked. The encoders count in
steps, from a zero that may be wrong. A watchdog stands before the drives: without valid commands
the arm stops by itself. Gravity is compensated, and the joints' ranges end at hard stops. MuJoCo
counts in m, everything else here counts in mm.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import numpy as np

from rcmservo.constraints import Checked, Triple, above, angles, between, each, finite, not_negative
from rcmservo.guard.watchdog import Watchdog
from rcmservo.interfaces import Command, Floats, Measured
from rcmservo.loop.joint_history import JointHistory
from rcmservo.method.kinematics import FULL_TURN, PITCH_YAW, Kinematics

PHYSICS: Any = mujoco
"""MuJoCo without types: its names are made at run time."""

STEP = 1_000_000
"""ns of one step of the physics."""

PAST = 1000
"""Steps of the physics whose joints are stored."""

UNIT = 1.0, 1.0, 1e-3
"""One rad, rad, mm in MuJoCo's units."""

HARD_STOP = 1.02
"""The arm's own range, as a multiple of the joint limits' half range about their middle."""

AXES = {
    "spherical": ("0 0 1", "0 1 0", "0 0 1", (1, 0, 2)),
    "pitch-yaw": ("0 -1 0", "-1 0 0", "0 0 -1", (0, 1, 2)),
}
"""Outer hinge, inner hinge, slide, and where q's joints stand in that order: φ turns outside θ, yaw
outside pitch."""

NOT_NEGATIVE = each(not_negative(), "three numbers that are not negative (rad, rad, mm)")


@dataclass(frozen=True)
class Drive(Checked, section="drive"):
    """What stands between a command and a motion."""

    delay: Annotated[float, between(0.0, 1.0, "a time", "s")] = 0.004
    """s from a command to the moment at which the drives obey it."""

    lag: Annotated[float, between(0.001, 10.0, "a time", "s")] = 0.02
    """s, the time constant with which each drive follows (first order)."""

    deadband: Annotated[Triple, NOT_NEGATIVE] = (1e-4, 1e-4, 0.01)
    """rad/s, rad/s, mm/s below which a joint stays still."""

    encoder: Annotated[Triple, NOT_NEGATIVE] = (2e-5, 2e-5, 2e-3)
    """rad, rad, mm of one count of each encoder."""

    encoder_offset: Annotated[
        Triple, each(finite(), "three finite numbers (rad, rad, mm)"), angles(FULL_TURN, first=2)
    ] = (0.0, 0.0, 0.0)
    """rad, rad, mm by which the joints that the arm tells are beside those that it has. Of an
    emulated motion controller, whose encoders count from where they are homed, it is none."""

    rate_error: Annotated[Triple, each(above(-1.0, 1.0), "three shares above -1 and at most 1")] = (
        0.0,
        0.0,
        0.0,
    )
    """Shares by which each joint moves faster than it is asked to."""

    def told(self, q: Floats) -> Floats:
        """What an arm tells with its joints at q (3,), but for counting."""
        return q + np.array(self.encoder_offset)

    def true(self, told: Floats) -> Floats:
        """Where the joints (3,) of an arm are that tells these, but for counting."""
        return told - np.array(self.encoder_offset)


MODEL = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{timestep}" integrator="implicitfast"/>
  <worldbody>
    <body gravcomp="1">
      <joint name="outer" type="hinge" axis="{outer}" range="{outer_range}" armature="0.01"/>
      <geom type="sphere" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
      <body gravcomp="1">
        <joint name="inner" type="hinge" axis="{inner}" range="{inner_range}" armature="0.01"/>
        <geom type="sphere" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
        <body gravcomp="1">
          <joint name="slide" type="slide" axis="{slide}" range="{slide_range}" armature="0.5"/>
          <geom type="capsule" fromto="0 0 -0.05 0 0 0.05" size="0.004" mass="0.2"
                contype="0" conaffinity="0"/>
          <site name="reference" pos="0 0 {reference:.9g}"/>
        </body></body></body>
  </worldbody>
  <actuator>
    <velocity joint="outer" kv="20"/><velocity joint="inner" kv="20"/>
    <velocity joint="slide" kv="1000"/>
  </actuator>
</mujoco>"""
"""Two hinges through the origin, a slide along the tool, and the reference point (MJCF)."""


def model_of(mechanism: Kinematics) -> str:
    """The MJCF of an RCM mechanism."""
    outer, inner, slide, order = AXES[mechanism.name]
    lower, upper = np.array(mechanism.limits.lower), np.array(mechanism.limits.upper)
    middle, half = (upper + lower) / 2.0, (upper - lower) / 2.0
    unit = np.array(UNIT)
    low, high = unit * (middle - HARD_STOP * half), unit * (middle + HARD_STOP * half)
    ranges = [f"{low[i]:.9g} {high[i]:.9g}" for i in order]
    sign = -1.0 if mechanism.kind == PITCH_YAW else 1.0
    return MODEL.format(
        timestep=STEP * 1e-9,
        outer=outer,
        inner=inner,
        slide=slide,
        outer_range=ranges[0],
        inner_range=ranges[1],
        slide_range=ranges[2],
        reference=sign * 1e-3 * mechanism.insertion_zero,
    )


class SimulatedArm:
    """An RCM mechanism in MuJoCo, driven by joint rates. It moves only while `advance` lets time
    pass, and it remembers where it was."""

    gains: list[float]
    """What each of the 3 motors makes of its rate: 1, but for one that is blocked or wrongly
    wired."""

    creep: list[float]
    """(rad/s, rad/s, mm/s) by which each motor that is on moves beside what it is asked for."""

    clock_error: int
    """ns by which the arm's own clock is wrong."""

    before_step: Callable[[], None] | None
    """Is called before every step of the physics."""

    def __init__(self, mechanism: Kinematics, drive: Drive) -> None:
        self.mechanism, self.drive = mechanism, drive
        self.time, self.clock_error = 0, 0
        self.watchdog = Watchdog()
        self.gains, self.creep, self.before_step = [1.0, 1.0, 1.0], [0.0, 0.0, 0.0], None
        self._order = list(AXES[mechanism.name][3])
        self._in_order, self._unit = np.argsort(self._order), np.array(UNIT)
        self._model = PHYSICS.MjModel.from_xml_string(model_of(mechanism))
        self._data = PHYSICS.MjData(self._model)
        self._queue: deque[tuple[int, list[float]]] = deque()
        self._wanted, self._rates = [0.0] * 3, [0.0] * 3
        self._controlled = False
        self._follow = float(1.0 - np.exp(-STEP * 1e-9 / drive.lag))
        self._made = [1.0 + share for share in drive.rate_error]
        self._encoder = np.maximum(np.array(drive.encoder), 1e-12)
        self._past = JointHistory(PAST)
        self._past.add(self.time, self.q_true)

    def place(self, q: Floats) -> None:
        """Put the arm at q (3,), at rest and with its drives off, as if it had always been there.

        Only a simulation can do that.
        """
        self.watchdog.disable()
        self._data.qpos[:] = (q * UNIT)[self._order]
        self._data.qvel[:] = 0.0
        self._come_to_rest()
        PHYSICS.mj_forward(self._model, self._data)
        self._past.clear()
        self._past.add(self.time, self.q_true)

    def advance_until(self, time: int) -> None:
        """Let time pass until `time` ns, to the nearest step."""
        while self.time + STEP // 2 < time:
            self.advance()

    def advance(self) -> None:
        """Let one step of time pass."""
        self.time += STEP
        if self.before_step is not None:
            self.before_step()
        if not self._controlled and not self.watchdog.check(self._clock):
            self._come_to_rest()
        while self._queue and self._queue[0][0] <= self.time:
            self._wanted = self._queue.popleft()[1]
        self._drive()
        PHYSICS.mj_step(self._model, self._data)
        self._past.add(self.time, self.q_true)

    def control(self, rates: list[float], on: bool) -> None:
        """Have the drives follow joint rates (3,), in place of commands: as a motion controller
        between them and the computer does, which has a watchdog of its own."""
        self._controlled = True
        if on:
            self._queue.append((self.time + round(self.drive.delay * 1e9), rates))
        else:
            self._come_to_rest()

    def _come_to_rest(self) -> None:
        self._queue.clear()
        self._wanted, self._rates = [0.0] * 3, [0.0] * 3

    def _drive(self) -> None:
        """Let each motor follow the rate that is wanted.

        Plain numbers: for three of them arrays would take longer than the physics.
        """
        for i in range(3):
            self._rates[i] += self._follow * (self._wanted[i] - self._rates[i])
        rates, deadband = self._rates, self.drive.deadband
        moving = [rates[i] if abs(rates[i]) > deadband[i] else 0.0 for i in range(3)]
        creep = self.creep if self.watchdog.enabled else (0.0, 0.0, 0.0)
        made = [self.gains[i] * self._made[i] * moving[i] + creep[i] for i in range(3)]
        self._data.ctrl[:] = [made[i] * UNIT[i] for i in self._order]

    def joints_at(self, time: int) -> Floats:
        """The joints (3,) as they were at a moment (ns) of the last second; before it the oldest
        that are known."""
        return self._past.at(time)

    @property
    def q_true(self) -> Floats:
        """The joints (3,) as they are: MuJoCo has them in its own order and units."""
        return self._data.qpos[self._in_order] / self._unit

    @property
    def p_true(self) -> Floats:
        """Where the physics has the tool's reference point, (3,) mm."""
        PHYSICS.mj_forward(self._model, self._data)
        return self._data.site("reference").xpos * 1e3

    @property
    def _clock(self) -> int:
        """The time (ns) that the arm takes it to be."""
        return self.time + self.clock_error

    def enable(self) -> None:
        """Switch the drives on, at rest."""
        self.watchdog.enable(self._clock)

    def measure(self) -> Measured:
        """The arm's answer: the joints as the encoders count them."""
        counted = np.round(self.drive.told(self.q_true) / self._encoder) * self._encoder
        return Measured(self._clock, counted, self.watchdog.enabled)

    def apply(self, command: Command) -> Floats:
        """Take a command if the watchdog lets it; gives the rates (3,) that were taken.

        The drives have no limits of their own.
        """
        if self.watchdog.feed(command, self._clock):
            obeyed = self.time + round(self.drive.delay * 1e9)
            self._queue.append((obeyed, self.watchdog.rates.tolist()))
        return self.watchdog.rates


class SimulatedClock:
    """The clock of a simulated plant. Its time is that of the arm's physics."""

    stalls: Callable[[int], int] | None
    """Tells until when a wait really lasts, where the process that waits is held up."""

    def __init__(self, arm: SimulatedArm) -> None:
        self._arm = arm
        self.stalls = None

    def now(self) -> int:
        return self._arm.time

    def wait_until(self, time: int) -> None:
        self._arm.advance_until(time if self.stalls is None else self.stalls(time))
