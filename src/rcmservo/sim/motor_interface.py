"""Interfaces through which emulated controllers drive the simulated arm."""

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
        self._until = float(arm.time)
        self._zero = arm.q_true
        limits = arm.mechanism.limits
        lower, upper = np.array(limits.lower), np.array(limits.upper)
        middle, half = (upper + lower) / 2.0, LIMIT_SWITCH_RATIO * (upper - lower) / 2.0
        self._lower, self._upper = middle - half, middle + half

    @property
    def lag(self) -> float:
        """Time constant (s) of the drives."""
        return self.arm.drive.lag

    def step(self, speeds: Sequence[float], on: Sequence[bool], seconds: float) -> Sequence[float]:
        """Let one sample of `seconds` pass and return the encoders' counts of all axes.

        Parameters
        ----------
        speeds : sequence of float
            Speeds of all axes, counts/s.
        on : sequence of bool
            Axes whose motors are on.
        seconds : float
            Length of the sample, s.
        """
        rates = np.where(on[:3], speeds[:3], 0.0) / self.counts
        self.arm.control(rates.tolist(), any(on[:3]))
        self._until += seconds * 1e9
        self.arm.advance_until(round(self._until))
        counted = np.round((self.arm.q_true - self._zero) * self.counts)
        return [*counted.tolist(), *[0.0] * (self.axes - 3)]

    def switches(self) -> Sequence[tuple[bool, bool]]:
        """Return for each axis if its forward and its reverse limit switch are active."""
        q = self.arm.q_true
        over, under = (q > self._upper).tolist(), (q < self._lower).tolist()
        forward = [o if c > 0 else u for o, u, c in zip(over, under, self.counts, strict=True)]
        reverse = [u if c > 0 else o for o, u, c in zip(over, under, self.counts, strict=True)]
        unwired = [(False, False)] * (self.axes - 3)
        return [*zip(forward, reverse, strict=True), *unwired]


class SimulatedJoints:
    """Three joints with brakes that the arm's own controller drives by rates.

    Time passes only in `step`.
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
