"""Watchdog of a device: it switches the drive off when valid commands stop arriving.

A command is valid if it is finite, its number is higher than every number since the drive was
switched on, and its deadline is neither past nor further ahead than the watchdog's timeout. Noise,
a repeated old command or an open connection therefore do not keep the drive on. Without a valid
command in time, or if the clock goes back, the joint rates are set to zero and the drive is
switched off until the operator switches it on.

The simulated arm (sim/arm.py) uses this class. Real arms have their own: a Galil controller runs
hardware/galil/watchdog_program.py, and hardware/crtk/arm.py checks the deadlines of a CRTK arm. The
supervisor (live/supervisor.py) watches the servo process.
"""

import math

import numpy as np

from rcmservo.constraints import positive
from rcmservo.interfaces import Command, Floats

WATCHDOG_TIMEOUT_NS = 50_000_000
"""Default timeout (ns) after which a device stops by itself."""


class Watchdog:
    """Watchdog of one device.

    Parameters
    ----------
    timeout : int
        Timeout in ns, positive.

    Attributes
    ----------
    enabled : bool
        True if the drive is on.
    rates : Floats
        Joint rates of the last valid command, (3,); zero while the drive is off.
    number : int
        Number of the last valid command, -1 before the first.

    Raises
    ------
    BadInput
        If the timeout is not positive.

    Notes
    -----
    The argument `now` of the methods is the device's own time in ns. Deadlines refer to the same
    clock.
    """

    def __init__(self, timeout: int = WATCHDOG_TIMEOUT_NS) -> None:
        positive("time in ns").require("timeout", timeout)
        self.timeout = timeout
        self.enabled = False
        self.rates: Floats = np.zeros(3)
        self.number = -1
        self._deadline = self._last_check = 0

    def enable(self, now: int) -> None:
        """Switch the drive on, at rest. The first command must arrive within the timeout."""
        self.enabled, self.rates = True, np.zeros(3)
        self.number, self._deadline, self._last_check = -1, now + self.timeout, now

    def disable(self) -> None:
        """Set the rates to zero and switch the drive off."""
        self.enabled, self.rates = False, np.zeros(3)

    def feed(self, command: Command, now: int) -> bool:
        """Accept a command if it is valid, and return True if it was accepted.

        A command that switches the drive off is always accepted.
        """
        if not command.enabled:
            self.disable()
            return True
        self.check(now)
        in_time = now <= command.deadline <= now + self.timeout
        is_finite = command.rates.shape == (3,) and all(map(math.isfinite, command.rates.tolist()))
        if not (self.enabled and command.number > self.number and in_time and is_finite):
            return False
        self.number, self._deadline = command.number, command.deadline
        self.rates = command.rates.copy()
        return True

    def check(self, now: int) -> bool:
        """Switch the drive off if no valid command arrived in time; return True if it is on.

        The drive is also switched off if the clock went back: the age of the last command is
        unknown then.
        """
        if self.enabled and not self._last_check <= now <= self._deadline:
            self.disable()
        self._last_check = now
        return self.enabled
