"""The simulated arm: a MuJoCo model with velocity drives, and what its ideal drives lack.

A command reaches a joint after a delay, through a first-order lag, and not at all inside the
deadband; the encoders count in steps. A watchdog stands before the drives: without valid commands
the arm stops by itself. Gravity is compensated, the ends of the joints' ranges are hard. MuJoCo
counts in m, everything else here in mm.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from rcmservo.errors import require
from rcmservo.guard.watchdog import Watchdog
from rcmservo.interfaces import Command, Floats, Measured
from rcmservo.method.kinematics import PITCH_YAW, Kinematics

PHYSICS: Any = mujoco
"""MuJoCo without types: its names are made at run time."""

STEP = 1_000_000
"""ns of one step of the physics."""

UNIT = np.array([1.0, 1.0, 1e-3])
"""One rad, rad, mm in MuJoCo's units."""

HARD_STOP = 1.02
"""The arm's own range, as a multiple of the joint limits' half range about their middle."""

AXES = {
    "spherical": ("0 0 1", "0 1 0", "0 0 1", (1, 0, 2)),
    "pitch-yaw": ("0 -1 0", "-1 0 0", "0 0 -1", (0, 1, 2)),
}
"""Outer hinge, inner hinge, slide, and where q's joints stand in that order: φ turns outside θ, yaw
outside pitch."""


@dataclass(frozen=True)
class Drive:
    """What stands between a command and a motion.

    ``delay`` s and ``lag`` s (first-order time constant) of each drive; ``deadband`` (rad/s, rad/s,
    mm/s) below which a joint stays still; ``encoder`` (rad, rad, mm) is one count of each encoder.
    """

    delay: float = 0.004
    lag: float = 0.02
    deadband: tuple[float, float, float] = (1e-4, 1e-4, 0.01)
    encoder: tuple[float, float, float] = (2e-5, 2e-5, 2e-3)

    def __post_init__(self) -> None:
        require(0.0 <= self.delay <= 1.0, "drive.delay", self.delay, "a time from 0 to 1 s")
        require(0.001 <= self.lag <= 10.0, "drive.lag", self.lag, "a time from 0.001 to 10 s")
        for name in ("deadband", "encoder"):
            values = getattr(self, name)
            good = len(values) == 3 and all(0.0 <= value < np.inf for value in values)
            require(
                good, f"drive.{name}", values, "three numbers that are not negative (rad, rad, mm)"
            )


def model_of(kinematics: Kinematics) -> str:
    """The MJCF of an RCM mechanism: two hinges through the origin, a slide along the tool, and the
    reference point."""
    outer, inner, slide, order = AXES[kinematics.name]
    middle = (np.array(kinematics.limits.upper) + kinematics.limits.lower) / 2.0
    half = (np.array(kinematics.limits.upper) - kinematics.limits.lower) / 2.0
    low, high = UNIT * (middle - HARD_STOP * half), UNIT * (middle + HARD_STOP * half)
    ranges = [f"{low[i]:.9g} {high[i]:.9g}" for i in order]
    sign = -1.0 if kinematics.kind == PITCH_YAW else 1.0
    reference = f"0 0 {sign * 1e-3 * kinematics.insertion_zero:.9g}"
    return f"""
    <mujoco>
      <compiler angle="radian" autolimits="true"/>
      <option timestep="{STEP * 1e-9}" integrator="implicitfast"/>
      <worldbody>
        <body gravcomp="1">
          <joint name="outer" type="hinge" axis="{outer}" range="{ranges[0]}" armature="0.01"/>
          <geom type="sphere" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
          <body gravcomp="1">
            <joint name="inner" type="hinge" axis="{inner}" range="{ranges[1]}" armature="0.01"/>
            <geom type="sphere" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
            <body gravcomp="1">
              <joint name="slide" type="slide" axis="{slide}" range="{ranges[2]}" armature="0.5"/>
              <geom type="capsule" fromto="0 0 -0.05 0 0 0.05" size="0.004" mass="0.2"
                    contype="0" conaffinity="0"/>
              <site name="reference" pos="{reference}"/>
            </body></body></body>
      </worldbody>
      <actuator>
        <velocity joint="outer" kv="20"/><velocity joint="inner" kv="20"/>
        <velocity joint="slide" kv="1000"/>
      </actuator>
    </mujoco>"""


class SimulatedArm:
    """An RCM mechanism in MuJoCo, driven by joint rates. It moves only when `advance` lets time
    pass.

    ``gains`` (3,) is what each motor makes of its rate: 1, but for one that is blocked or wrongly
    wired. `before_step` is called before every step.
    """

    def __init__(self, kinematics: Kinematics, drive: Drive) -> None:
        self.kinematics, self.drive = kinematics, drive
        self.time = 0
        self.watchdog = Watchdog()
        self._order = np.array(AXES[kinematics.name][3])
        self._model = PHYSICS.MjModel.from_xml_string(model_of(kinematics))
        self._data = PHYSICS.MjData(self._model)
        self._queue: deque[tuple[int, Floats]] = deque()
        self._wanted = np.zeros(3)
        self._rates = np.zeros(3)
        self.gains = np.ones(3)
        self.before_step: Callable[[], None] | None = None
        self._follow = 1.0 - np.exp(-STEP * 1e-9 / drive.lag)
        self._deadband = np.array(drive.deadband)
        self._encoder = np.maximum(np.array(drive.encoder), 1e-12)

    def place(self, q: Floats) -> None:
        """Put the arm at q (3,) at rest, its drives off, as a hand would: simulation's
        privilege."""
        self.watchdog.disable()
        self._data.qpos[:] = (q * UNIT)[self._order]
        self._data.qvel[:] = 0.0
        self._queue.clear()
        self._wanted, self._rates = np.zeros(3), np.zeros(3)
        PHYSICS.mj_forward(self._model, self._data)

    def advance(self) -> None:
        """Let one step of time pass."""
        self.time += STEP
        if self.before_step is not None:
            self.before_step()
        if not self.watchdog.check(self.time):
            self._queue.clear()
            self._wanted, self._rates = np.zeros(3), np.zeros(3)
        while self._queue and self._queue[0][0] <= self.time:
            self._wanted = self._queue.popleft()[1]
        self._rates += self._follow * (self._wanted - self._rates)
        moving = np.where(np.abs(self._rates) > self._deadband, self._rates, 0.0)
        self._data.ctrl[:] = (self.gains * moving * UNIT)[self._order]
        PHYSICS.mj_step(self._model, self._data)

    @property
    def q_true(self) -> Floats:
        """The joints (3,) as they are."""
        q = np.empty(3)
        q[self._order] = self._data.qpos
        return q / UNIT

    @property
    def p_true(self) -> Floats:
        """Where the physics has the tool's reference point, (3,) mm."""
        PHYSICS.mj_forward(self._model, self._data)
        return self._data.site("reference").xpos * 1e3

    def enable(self) -> None:
        """Switch the drives on, at rest."""
        self.watchdog.enable(self.time)

    def measure(self) -> Measured:
        """The time ns, the joints (3,) as the encoders count them, and whether the drives are
        on."""
        return Measured(
            self.time, np.round(self.q_true / self._encoder) * self._encoder, self.watchdog.enabled
        )

    def apply(self, command: Command) -> Floats:
        """Take a command if the watchdog lets it; the rates (3,) are those taken, as the drives
        have no limits."""
        if self.watchdog.feed(command, self.time):
            self._queue.append((self.time + round(self.drive.delay * 1e9), self.watchdog.rates))
        return self.watchdog.rates
