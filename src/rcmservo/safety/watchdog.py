"""What stands between commands and drives inside the device: it trusts nothing but valid commands
that keep coming.

A command is valid if it is finite, its number is higher than that of every one since the drive went
on, and its deadline is neither past nor further off than the watchdog's own patience. Nothing else
feeds it: not noise, not an old command sent again, not a connection that stays open. Without a
valid command in time, or if the clock goes back, the joint rates are zero and the drive is off,
until a person switches it on.
"""

import math

import numpy as np

from rcmservo.constraints import positive
from rcmservo.interfaces import Command, Floats

PATIENCE = 50_000_000
"""ns of silence after which a device stops by itself."""


class Watchdog:
    """One device's guard. `now` is the device's own time in ns, the one that deadlines are given
    in.
    """

    def __init__(self, patience: int = PATIENCE) -> None:
        positive("time in ns").require("patience", patience)
        self.patience = patience
        self.enabled = False
        self.rates: Floats = np.zeros(3)
        self.number = -1
        self._deadline = self._newest = 0

    def enable(self, now: int) -> None:
        """Switch the drive on, at rest; commands must begin within the patience."""
        self.enabled, self.rates = True, np.zeros(3)
        self.number, self._deadline, self._newest = -1, now + self.patience, now

    def disable(self) -> None:
        """Zero and off, now."""
        self.enabled, self.rates = False, np.zeros(3)

    def feed(self, command: Command, now: int) -> bool:
        """Take a command if it is valid; whether it was. Switching off is always taken."""
        if not command.enabled:
            self.disable()
            return True
        self.check(now)
        in_time = now <= command.deadline <= now + self.patience
        finite = command.rates.shape == (3,) and all(map(math.isfinite, command.rates.tolist()))
        if not (self.enabled and command.number > self.number and in_time and finite):
            return False
        self.number, self._deadline, self.rates = (
            command.number,
            command.deadline,
            command.rates.copy(),
        )
        return True

    def check(self, now: int) -> bool:
        """Whether the drive may stay on at `now`; if no valid command came in time, it goes off.

        So it does if the clock went back: nobody knows then how long ago the last command came.
        """
        if self.enabled and not self._newest <= now <= self._deadline:
            self.disable()
        self._newest = now
        return self.enabled
