"""Simulated arm and its clock: a MuJoCo model with velocity drives and the faults of real drives.

A command reaches a joint after a delay and through a first-order lag. A rate inside the deadband
moves nothing, a joint at rest may need a larger one to start, and the actual rate may differ from
the commanded one by a constant ratio. The
encoders at the motors quantise the joints and may have a zero offset; with backlash the tool
follows the motors late. A watchdog stops the arm when no more valid commands arrive. Gravity is
compensated, and hard stops end the joint ranges. MuJoCo uses m; everything else here uses mm.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import numpy as np

from rcmservo.constraints import Checked, Triple, above, angles, between, each, finite, not_negative
from rcmservo.geometry.kinematics import FULL_TURN_RAD, PITCH_YAW, Kinematics
from rcmservo.interfaces import ArmMeasurement, Command, Floats
from rcmservo.loop.joint_history import JointHistory
from rcmservo.safety.watchdog import Watchdog
from rcmservo.sim.imperfect_markers import (
    NO_IMPERFECTIONS,
    ImperfectionsStruct,
    follow_with_backlash,
)

UNTYPED_MUJOCO: Any = mujoco
"""MuJoCo as an untyped module: it creates its names at run time."""

PHYSICS_STEP_NS = 1_000_000
"""Time step of the physics, ns."""

HISTORY_STEPS = 1000
"""Number of physics steps whose joints are stored: the last second."""

MUJOCO_UNITS = 1.0, 1.0, 1e-3
"""Factors from the joint units (rad, rad, mm) to those of MuJoCo (rad, rad, m)."""

HARD_STOP_RATIO = 1.02
"""Ratio of the hard stops' half range to the joint limits' half range, about the same middle."""

MJCF_AXES = {
    "spherical": ("0 0 1", "0 1 0", "0 0 1", (1, 0, 2)),
    "pitch-yaw": ("0 -1 0", "-1 0 0", "0 0 -1", (0, 1, 2)),
}
"""By the mechanism's name: axes of the outer hinge (φ or yaw), the inner hinge (θ or pitch) and the
slide, and the indices of their joints in q."""

NOT_NEGATIVE_JOINTS = each(not_negative(), "three numbers that are not negative (rad, rad, mm)")
NOT_NEGATIVE_RATES = each(not_negative(), "three rates that are not negative (rad/s, rad/s, mm/s)")
FINITE_JOINTS = each(finite(), "three finite numbers (rad, rad, mm)")
ENCODER_ANGLES = angles(FULL_TURN_RAD, first=2)
RATE_ERROR_LIMIT = each(above(-1.0, 1.0), "three ratios above -1 and at most 1")


@dataclass(frozen=True)
class Drive(Checked, section="drive"):
    """Drives and encoders of the simulated arm: delay, lag, deadband, stiction and errors.

    Parameters
    ----------
    delay : float
        Time (s) from a command until the drives follow it, 0 to 1.
    lag : float
        Time constant (s) of each drive's first-order response, 0.001 to 10.
    deadband : Triple
        Rates (rad/s, rad/s, mm/s) below which a joint does not move, not negative.
    stiction : Triple
        Rates (rad/s, rad/s, mm/s) below which a joint at rest does not start to move, not negative.
    encoder : Triple
        Resolution (rad, rad, mm) of the encoders, not negative: the joint motion of one count.
    encoder_offset : Triple
        Encoder offset (rad, rad, mm): measured joints minus true joints; angles at most one turn.
        An emulated motion controller ignores it, because its encoders count from the joints at
        which they are homed.
    rate_error : Triple
        Relative rate errors, above -1 and at most 1: a joint's actual rate is 1 + rate_error times
        its commanded rate.

    Raises
    ------
    BadInput
        If a field is outside its range.
    """

    delay: Annotated[float, between(0.0, 1.0, "a time", "s")] = 0.004

    lag: Annotated[float, between(0.001, 10.0, "a time", "s")] = 0.02

    deadband: Annotated[Triple, NOT_NEGATIVE_RATES] = (1e-4, 1e-4, 0.01)

    stiction: Annotated[Triple, NOT_NEGATIVE_RATES] = (0.0, 0.0, 0.0)

    encoder: Annotated[Triple, NOT_NEGATIVE_JOINTS] = (2e-5, 2e-5, 2e-3)

    encoder_offset: Annotated[Triple, FINITE_JOINTS, ENCODER_ANGLES] = (0.0, 0.0, 0.0)

    rate_error: Annotated[Triple, RATE_ERROR_LIMIT] = (0.0, 0.0, 0.0)

    def measured(self, q: Floats) -> Floats:
        """Return the joints (3,) that unquantised encoders report at the true joints q (3,)."""
        return q + np.array(self.encoder_offset)

    def true(self, measured: Floats) -> Floats:
        """Return the true joints (3,) at which unquantised encoders report `measured` (3,)."""
        return measured - np.array(self.encoder_offset)


def write_mjcf(mechanism: Kinematics) -> str:
    """Return the MJCF text of an RCM mechanism.

    It has two hinges through the origin, a slide along the tool, and the tool's reference point.
    """
    outer, inner, slide, joint_order = MJCF_AXES[mechanism.name]
    lower, upper = np.array(mechanism.limits.lower), np.array(mechanism.limits.upper)
    middle, half_range = (upper + lower) / 2.0, (upper - lower) / 2.0
    low = np.array(MUJOCO_UNITS) * (middle - HARD_STOP_RATIO * half_range)
    high = np.array(MUJOCO_UNITS) * (middle + HARD_STOP_RATIO * half_range)
    outer_range, inner_range, slide_range = (f"{low[i]:.9g} {high[i]:.9g}" for i in joint_order)
    reference = (-1e-3 if mechanism.kind == PITCH_YAW else 1e-3) * mechanism.insertion_zero
    return f"""
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{PHYSICS_STEP_NS * 1e-9}" integrator="implicitfast"/>
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


NO_GAP = np.zeros(3)
"""Tool in the middle of the gaps of the backlash."""

NO_CREEP = 0.0, 0.0, 0.0
"""Rates (rad/s, rad/s, mm/s) that motors add while the drive is off."""


class SimulatedArm:
    """RCM mechanism in MuJoCo, driven by joint rates.

    The arm moves only in `advance` and `advance_until`. It stores its joints of the last
    `HISTORY_STEPS` steps.

    Parameters
    ----------
    mechanism : Kinematics
        Kinematics and joint limits.
    drive : Drive
        Delay, lag, deadband and errors of the drives and encoders.
    imperfections : ImperfectionsStruct
        Backlash, errors of the rates and period of the joint reports; none by default.
    """

    gains: list[float]
    """Ratios of each motor's rate to its input: 1 unless a disturbance changes them."""

    creep: list[float]
    """Rates (rad/s, rad/s, mm/s) that each enabled motor adds to its commanded rate."""

    clock_error: int
    """Error of the arm's own clock, ns."""

    before_step: Callable[[], None] | None
    """Callback that runs before every physics step, if set."""

    def __init__(
        self,
        mechanism: Kinematics,
        drive: Drive,
        imperfections: ImperfectionsStruct = NO_IMPERFECTIONS,
    ) -> None:
        self.imperfections = imperfections
        self.mechanism, self.drive = mechanism, drive
        self.time, self.clock_error = 0, 0
        self.watchdog = Watchdog()
        self.gains, self.creep, self.before_step = [1.0, 1.0, 1.0], [0.0, 0.0, 0.0], None
        self._mujoco_order = list(MJCF_AXES[mechanism.name][3])
        self._joint_order, self._unit = np.argsort(self._mujoco_order), np.array(MUJOCO_UNITS)
        self._model = UNTYPED_MUJOCO.MjModel.from_xml_string(write_mjcf(mechanism))
        self._data = UNTYPED_MUJOCO.MjData(self._model)
        # views: each access makes one
        self._qpos, self._qvel, self._ctrl = self._data.qpos, self._data.qvel, self._data.ctrl
        self._queue: deque[tuple[int, list[float]]] = deque()
        self._setpoint, self._rates = [0.0] * 3, [0.0] * 3
        self._is_bypassed = False
        self._has_stiction = any(drive.stiction)
        self._lag_fraction = float(1.0 - np.exp(-PHYSICS_STEP_NS * 1e-9 / drive.lag))
        ratios = (1.0 + np.array(drive.rate_error)) * imperfections.rate_ratios
        self._rate_ratios: list[float] = ratios.tolist()
        self._resolution = np.maximum(np.array(drive.encoder), 1e-12)
        self._history = JointHistory(HISTORY_STEPS)
        self._joints, self._has_backlash = self.q_motor, bool(imperfections.half_gap.any())
        self._report = ArmMeasurement(-1, self._joints, False)
        self._history.add(self.time, self.q_true)

    def place(self, q: Floats, in_gap: Floats = NO_GAP) -> None:
        """Put the motors at the joints q (3,), at rest and with the drives off.

        The tool is at `in_gap` (3,), -1 to 1, in the gaps of the backlash. The history of the
        joints restarts there. Only a simulation can do this.
        """
        self.watchdog.disable()
        self._qpos[:] = (q * MUJOCO_UNITS)[self._mujoco_order]
        self._data.qvel[:] = 0.0
        self._stop_drives()
        UNTYPED_MUJOCO.mj_forward(self._model, self._data)
        self._joints = self.q_motor + in_gap * self.imperfections.half_gap
        self._history.clear()
        self._history.add(self.time, self.q_true)

    def advance_until(self, time: int) -> None:
        """Let time pass until `time` (ns), to the nearest physics step."""
        while self.time + PHYSICS_STEP_NS // 2 < time:
            self.advance()

    def advance(self) -> None:
        """Let one physics step pass."""
        self.time += PHYSICS_STEP_NS
        if self.before_step is not None:
            self.before_step()
        if not self._is_bypassed and not self.watchdog.check(self._device_time):
            self._stop_drives()
        while self._queue and self._queue[0][0] <= self.time:
            self._setpoint = self._queue.popleft()[1]
        self._step_drives()
        UNTYPED_MUJOCO.mj_step(self._model, self._data)
        if self._has_backlash:
            self._joints = self._joints.copy()
            follow_with_backlash(self.imperfections.rows[0], self.q_motor, self._joints)
        self._history.add(self.time, self.q_true)

    def control(self, rates: list[float], on: bool) -> None:
        """Make the drives follow joint rates (3,) that bypass the arm's command interface.

        An emulated motion controller calls this. It is between the computer and the drives and has
        its own watchdog, so the arm's watchdog is not checked from then on.

        Parameters
        ----------
        rates : list of float
            Joint rates (rad/s, rad/s, mm/s).
        on : bool
            False stops the drives at once.
        """
        self._is_bypassed = True
        if on:
            self._queue.append((self.time + round(self.drive.delay * 1e9), rates))
        else:
            self._stop_drives()

    def _stop_drives(self) -> None:
        """Drop all queued commands and zero the rates."""
        self._queue.clear()
        self._setpoint, self._rates = [0.0] * 3, [0.0] * 3

    def _step_drives(self) -> None:
        """Advance each motor's lag by one step and write the motor rates to MuJoCo.

        Plain Python numbers: NumPy arrays of three entries would take longer than the physics.
        """
        rates, setpoint, lag_fraction = self._rates, self._setpoint, self._lag_fraction
        gains, rate_ratios, deadband = self.gains, self._rate_ratios, self.drive.deadband
        creep = self.creep if self.watchdog.enabled else NO_CREEP
        for index, i in enumerate(self._mujoco_order):
            rates[i] += lag_fraction * (setpoint[i] - rates[i])
            least = deadband[i]
            rest_speed = rate_ratios[i] * least * MUJOCO_UNITS[i]
            if self._has_stiction and abs(self._qvel[index]) <= rest_speed:
                least = max(least, self.drive.stiction[i])
            moving = rates[i] if abs(rates[i]) > least else 0.0
            actual = gains[i] * rate_ratios[i] * moving + creep[i]
            self._ctrl[index] = actual * MUJOCO_UNITS[i]

    def joints_at(self, time: int) -> Floats:
        """Return the joints (3,) at a time (ns) within the last second.

        Before that second, return the oldest stored joints.
        """
        return self._history.interpolate(time)

    @property
    def q_true(self) -> Floats:
        """True joints (3,) of the tool."""
        return self._joints if self._has_backlash else self.q_motor

    @property
    def q_motor(self) -> Floats:
        """True joints (3,) at the motors, converted from MuJoCo's order and units."""
        return self._qpos[self._joint_order] / self._unit

    @property
    def p_true(self) -> Floats:
        """True position (3,) mm of the tool's reference point, from MuJoCo's kinematics."""
        UNTYPED_MUJOCO.mj_forward(self._model, self._data)
        return self._data.site("reference").xpos * 1e3

    @property
    def _device_time(self) -> int:
        """Time (ns) on the arm's own clock."""
        return self.time + self.clock_error

    def enable(self) -> None:
        """Switch the drives on, at rest."""
        self.watchdog.enable(self._device_time)

    def measure(self) -> ArmMeasurement:
        """Return the time (ns), the joints (3,) of the quantised encoders and the drives' state."""
        if self.time >= self._report.time + self.imperfections.report_period:
            measured = self.drive.measured(self.q_motor)
            q = np.round(measured / self._resolution) * self._resolution
            self._report = ArmMeasurement(self.time, q, self.watchdog.enabled)
        return ArmMeasurement(self._device_time, self._report.q, self.watchdog.enabled)

    def apply(self, command: Command) -> Floats:
        """Queue a command if the watchdog accepts it, and return the accepted rates (3,).

        The drives have no rate limits.
        """
        if self.watchdog.feed(command, self._device_time):
            start_time = self.time + round(self.drive.delay * 1e9)
            self._queue.append((start_time, self.watchdog.rates.tolist()))
        return self.watchdog.rates


class SimulatedClock:
    """Clock of a simulated plant: the time of the arm's physics, which advances in `wait_until`."""

    stalls: Callable[[int], int] | None
    """Function from the requested end of a wait (ns) to its actual end, if disturbances delay the
    process."""

    def __init__(self, arm: SimulatedArm) -> None:
        self._arm = arm
        self.stalls = None

    def now(self) -> int:
        """Return the present time, ns."""
        return self._arm.time

    def wait_until(self, time: int) -> None:
        """Let time pass until `time` (ns), or longer if a disturbance delays the process."""
        self._arm.advance_until(time if self.stalls is None else self.stalls(time))
