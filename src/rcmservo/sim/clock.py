"""Simulated time: it passes only while somebody waits, and the arm moves meanwhile."""

from collections.abc import Callable

from rcmservo.sim.arm import SimulatedArm


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
