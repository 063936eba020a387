"""Interface between the emulated controller and the motors that it drives.

The simulated arm of `rcmservo.sim` implements it.
"""

from collections.abc import Sequence
from typing import Protocol


class Motors(Protocol):
    """Motors of the axes, with their encoders and limit switches."""

    @property
    def lag(self) -> float:
        """Time constant of the motors in s. The emulated controller is tuned to it."""
        ...

    def step(self, speeds: Sequence[float], on: Sequence[bool], seconds: float) -> Sequence[float]:
        """Advance by one sample and return the encoder positions in counts.

        Parameters
        ----------
        speeds : sequence of float
            Commanded speed of each axis in counts/s.
        on : sequence of bool
            True for each motor that is on.
        seconds : float
            Sample time in s.
        """
        ...

    def switches(self) -> Sequence[tuple[bool, bool]]:
        """Return for each axis whether its forward and its reverse limit switch are tripped."""
        ...
