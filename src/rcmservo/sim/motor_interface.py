"""The simulated arm as the motors, encoders and limit switches that a motion controller drives."""

from collections.abc import Sequence

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.arm import SimulatedArm

AT_LIMIT = 0.99
"""Of the joint limits' half range about their middle: where the limit switches are."""


class ArmMotors:
    """One motor for each joint, in turn, and after them axes to which nothing is wired.

    ``counts`` (3,) are those of a rad, rad and mm, negative where a motor turns the other way.
    """

    def __init__(self, arm: SimulatedArm, counts: Floats, axes: int) -> None:
        self.arm, self.counts, self.axes = arm, counts, axes
        self._until = float(arm.time)
        self._zero = arm.q_true
        limits = arm.mechanism.limits
        lower, upper = np.array(limits.lower), np.array(limits.upper)
        middle, half = (upper + lower) / 2.0, AT_LIMIT * (upper - lower) / 2.0
        self._lower, self._upper = middle - half, middle + half

    @property
    def lag(self) -> float:
        """The time constant s with which the drives follow."""
        return self.arm.drive.lag

    def step(self, speeds: Sequence[float], on: Sequence[bool], seconds: float) -> Sequence[float]:
        """Let a sample pass with these speeds [counts/s]; where the encoders are then, counts."""
        rates = np.where(on[:3], speeds[:3], 0.0) / self.counts
        self.arm.control(rates.tolist(), any(on[:3]))
        self._until += seconds * 1e9
        self.arm.advance_until(round(self._until))
        counted = np.round((self.arm.q_true - self._zero) * self.counts)
        return [*counted.tolist(), *[0.0] * (self.axes - 3)]

    def switches(self) -> Sequence[tuple[bool, bool]]:
        """Whether the forward and the reverse limit switch of each axis are tripped."""
        q = self.arm.q_true
        over, under = (q > self._upper).tolist(), (q < self._lower).tolist()
        forward = [o if c > 0 else u for o, u, c in zip(over, under, self.counts, strict=True)]
        reverse = [u if c > 0 else o for o, u, c in zip(over, under, self.counts, strict=True)]
        free = [(False, False)] * (self.axes - 3)
        return [*zip(forward, reverse, strict=True), *free]


class SimulatedJoints:
    """The joints of a simulated arm, whose time passes in `step` alone."""

    def __init__(self, arm: SimulatedArm) -> None:
        self.arm = arm

    def step(self, rates: Floats, on: bool, time: int) -> Floats:
        """Let time pass until `time` ns with these joint rates (3,), or with the brakes on; where
        the encoders say that the joints (3,) are then."""
        self.arm.control(rates.tolist(), on)
        self.arm.advance_until(time)
        return self.arm.measure().q
