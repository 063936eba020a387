"""The simulated arm as three joints that an arm's own controller gives rates to, with brakes."""

from rcmservo.interfaces import Floats
from rcmservo.sim.arm import SimulatedArm


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
