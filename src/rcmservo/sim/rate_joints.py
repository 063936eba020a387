"""The simulated arm as three joints that are given rates, by an arm's own controller."""

import time

from rcmservo.interfaces import Floats
from rcmservo.sim.arm import SimulatedArm
from rcmservo.sim.processes.motion_log import MotionLog


class SimulatedJoints:
    """The joints of a simulated arm, and a log of what they did."""

    def __init__(self, arm: SimulatedArm, log: MotionLog) -> None:
        self.arm, self.log = arm, log
        self._begun = False

    def step(self, rates: Floats, on: bool, time_now: int) -> Floats:
        """Let time pass until `time_now` ns with these joint rates (3,); where the encoders say
        that the joints (3,) are then."""
        if not self._begun:
            self._begun = True
            self._stand(time_now)
        self.arm.control(rates.tolist(), on)
        self.arm.advance_until(time_now)
        number = self.log.count
        self.log.add(self.arm.time, time.monotonic_ns(), number, on, rates.copy(), self.arm.q_true)
        return self.arm.measure().q

    def _stand(self, time_now: int) -> None:
        """Begin at a moment, with the arm as it stands."""
        self.arm.time = time_now
        self.arm.place(self.arm.q_true)
