"""Where an arm is asked to be, when it takes positions and is to have speeds.

The rates are integrated from where the arm was when it was enabled. What is asked for never runs
farther ahead of where the arm is than its lead: an arm that is held up, or that loses its host,
goes on for that at most. Where the lead cuts, or time was lost, what was really taken is told.

The lead drags what is asked for along with an arm that is pushed. One wild place that the arm tells
would drag it there at once: a step that no motion explains is none.
"""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import JointLimits

LONGEST_STEP = 20_000_000
"""ns of motion that one command makes up for: what was missed beyond is left out."""
INSIDE = 1e-6
"""Of a joint's range: so far from its ends the setpoint stays, for arms that round it."""

JUMP = np.array([0.05, 0.05, 5.0])
"""rad, rad, mm beyond what the rates ask that the setpoint is dragged in one step at most."""


class Lead:
    """The setpoint (3,) rad, rad, mm of an arm, inside its limits wherever the lead lets it be."""

    def __init__(self, lead: Floats, limits: JointLimits) -> None:
        self._lead = lead
        lower, upper = limits.arrays
        inside = INSIDE * (upper - lower)
        self._lower, self._upper = lower + inside, upper - inside
        self._q, self._time = np.zeros(3), 0

    def anchor(self, q: Floats, now: int) -> None:
        """Begin at q, at rest."""
        self._q, self._time = q.copy(), now

    def step(self, rates: Floats, measured: Floats, now: int) -> tuple[Floats, Floats] | None:
        """The setpoint at `now` with these rates since the last step, with the arm measured at
        (3,); and the rates (3,) that this really is. None where it would jump: it stays."""
        passed = now - self._time
        asked = rates * min(max(passed, 0), LONGEST_STEP) * 1e-9
        wanted = self._q + asked
        allowed = np.clip(wanted, self._lower, self._upper)
        held = np.clip(allowed, measured - self._lead, measured + self._lead)
        if not (np.abs(held - self._q) <= np.abs(asked) + JUMP).all():
            return None
        took = (held - self._q) / (passed * 1e-9) if passed > 0 else np.zeros(3)
        self._q, self._time = held, max(now, self._time)
        return held, took
