"""Interfaces through which emulated controllers drive the simulated arm.

`SimulatedMotors` is for a motion controller that reads encoders, `SimulatedJoints` for an arm whose
own controller commands joint rates.
"""

from collections.abc import Sequence

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.arm import SimulatedArm

LIMIT_SWITCH_RATIO = 0.99
"""Ratio of the limit switches' half range to the joint limits' half range, about the same
middle."""


class SimulatedMotors:
    """Motors, encoders and limit switches of the arm, as a motion controller drives them.

    Parameters
    ----------
    arm : SimulatedArm
        Arm whose joints the first three motors move, in order. The other axes have no motor.
    counts : Floats, shape (3,)
        Encoder counts per rad, rad and mm; negative where a motor turns against its joint.
    axes : int
        Number of the controller's axes, at least 3.
    """

    def __init__(self, arm: SimulatedArm, counts: Floats, axes: int) -> None:
        self.arm, self.counts, self.axes = arm, counts, axes
        self._end_time = float(arm.time)
        self._zero_joints = arm.q_motor
        limits = arm.mechanism.limits
        lower, upper = np.array(limits.lower), np.array(limits.upper)
        middle, half_range = (upper + lower) / 2.0, LIMIT_SWITCH_RATIO * (upper - lower) / 2.0
        self._lower, self._upper = middle - half_range, middle + half_range

    @property
    def lag(self) -> float:
        """Time constant (s) of the drives' first-order response."""
        return self.arm.drive.lag

    def step(self, speeds: Sequence[float], on: Sequence[bool], seconds: float) -> Sequence[float]:
        """Let one sampling period pass and return the encoders' counts of all axes.

        Parameters
        ----------
        speeds : sequence of float
            Speeds of all axes, counts/s.
        on : sequence of bool
            Axes whose motors are on.
        seconds : float
            Sampling period of the controller, s.
        """
        rates = np.where(on[:3], speeds[:3], 0.0) / self.counts
        self.arm.control(rates.tolist(), any(on[:3]))
        self._end_time += seconds * 1e9
        self.arm.advance_until(round(self._end_time))
        joint_counts = np.round((self.arm.q_motor - self._zero_joints) * self.counts)
        return [*joint_counts.tolist(), *[0.0] * (self.axes - 3)]

    def switches(self) -> Sequence[tuple[bool, bool]]:
        """Return for each axis whether its forward and its reverse limit switch are active.

        A motor that turns against its joint reaches its forward switch at the joint's lower limit.
        """
        q = self.arm.q_motor
        is_above, is_below, same_sense = q > self._upper, q < self._lower, self.counts > 0
        forward = np.where(same_sense, is_above, is_below).tolist()
        reverse = np.where(same_sense, is_below, is_above).tolist()
        return [*zip(forward, reverse, strict=True), *[(False, False)] * (self.axes - 3)]


class SimulatedJoints:
    """Joints with brakes, which the arm's own controller drives by rates.

    Time passes only in `step`.

    Parameters
    ----------
    arm : SimulatedArm
        Arm with the joints.
    """

    def __init__(self, arm: SimulatedArm) -> None:
        self.arm = arm

    def step(self, rates: Floats, on: bool, time: int) -> Floats:
        """Let time pass until `time` (ns) and return the measured joints (3,).

        Parameters
        ----------
        rates : Floats, shape (3,)
            Joint rates (rad/s, rad/s, mm/s).
        on : bool
            False puts the brakes on.
        time : int
            End of the step, ns.
        """
        self.arm.control(rates.tolist(), on)
        self.arm.advance_until(time)
        return self.arm.measure().q
