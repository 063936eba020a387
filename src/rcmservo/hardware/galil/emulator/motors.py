"""What the emulated controller drives."""

from collections.abc import Sequence
from typing import Protocol


class Motors(Protocol):
    """The motors of the axes, with their encoders and limit switches."""

    @property
    def lag(self) -> float:
        """The time constant s with which they follow; the controller is tuned to it."""
        ...

    def step(self, speeds: Sequence[float], on: Sequence[bool], seconds: float) -> Sequence[float]:
        """Let a sample pass with these speeds [counts/s], of the motors that are on; where the
        encoders are then, counts."""
        ...

    def switches(self) -> Sequence[tuple[bool, bool]]:
        """Whether the forward and the reverse limit switch of each axis are tripped."""
        ...
