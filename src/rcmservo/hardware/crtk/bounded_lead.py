"""Position setpoint of an arm, integrated from commanded joint rates with a bounded lead.

The integration starts at the position of the arm when it is enabled. The setpoint never leads the
measured position by more than the lead. An arm that is blocked, or that loses its host, therefore
moves by the lead at most. The caller gets the rates that the setpoint really had, after the bounds
and after lost time.

If the arm is pushed, the bound drags the setpoint along. One invalid measurement would drag it too,
and at once, so a step beyond ``MAX_DRAG`` is refused.
"""

import numpy as np

from rcmservo.geometry.kinematics import JointLimits
from rcmservo.interfaces import Floats

MAX_STEP_NS = 20_000_000
"""Longest time that one step integrates. Time beyond it is lost."""
LIMIT_MARGIN = 1e-6
"""Distance of the setpoint from the joint limits, as a fraction of the range, for arms that round
it."""

MAX_DRAG = np.array([0.05, 0.05, 5.0])
"""Largest motion (rad, rad, mm) of the setpoint in one step beyond the commanded one."""


class BoundedLead:
    """Setpoint of the joints, shape (3,), in rad, rad, mm.

    It stays within the joint limits, unless the arm itself is beyond them by more than the lead.

    Parameters
    ----------
    lead : ndarray, shape (3,)
        Largest distance from the measured position, rad, rad, mm.
    limits : JointLimits
        Joint limits.
    """

    def __init__(self, lead: Floats, limits: JointLimits) -> None:
        self._lead = lead
        lower, upper = limits.arrays
        margin = LIMIT_MARGIN * (upper - lower)
        self._lower, self._upper = lower + margin, upper - margin
        self._q, self._time = np.zeros(3), 0

    def start(self, q: Floats, now: int) -> None:
        """Start at the joint position q (3,) in rad, rad, mm, at rest, at a time in ns."""
        self._q, self._time = q.copy(), now

    def step(self, rates: Floats, measured: Floats, now: int) -> tuple[Floats, Floats] | None:
        """Advance the setpoint.

        Parameters
        ----------
        rates : ndarray, shape (3,)
            Joint rates since the last step, rad/s, rad/s, mm/s.
        measured : ndarray, shape (3,)
            Measured position, rad, rad, mm.
        now : int
            Time in ns.

        Returns
        -------
        tuple of ndarray, shape (3,), or None
            Setpoint and its real rates. None if the setpoint would jump; it stays unchanged.
        """
        elapsed = now - self._time
        commanded = rates * min(max(elapsed, 0), MAX_STEP_NS) * 1e-9
        within_limits = np.clip(self._q + commanded, self._lower, self._upper)
        setpoint = np.clip(within_limits, measured - self._lead, measured + self._lead)
        if not (np.abs(setpoint - self._q) <= np.abs(commanded) + MAX_DRAG).all():
            return None
        real_rates = (setpoint - self._q) / (elapsed * 1e-9) if elapsed > 0 else np.zeros(3)
        self._q, self._time = setpoint, max(now, self._time)
        return setpoint, real_rates
