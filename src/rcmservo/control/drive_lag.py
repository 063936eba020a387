"""How long the drives lag behind what is asked of them, as a motion tells it.

A joint that follows its rate with a time constant T is behind by T times its speed, and a delay
looks the same while the rate changes slowly. So T is the slope of how far the joints are behind
over how fast they go, by least squares over all joints, each in units of its greatest speed.
"""

import numpy as np

from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, fill, put
from rcmservo.numerics.structs import Row, real, reals, whole

SUPPOSED = 0.025
"""s, before it is measured."""

LONGEST = 0.2
"""s. A drive that is slower than this does not follow."""

SHORTEST = 0.001
"""s. Of drives that follow at once,"""
AHEAD = -0.02
"""and of those whose joints are told so much later than the rates that they took."""


class DriveLag(Row):
    """What the motion so far tells of the drives."""

    behind: Floats = reals(3, "rad, rad, mm", "how far the joints are behind what was asked")
    joints: Floats = reals(3, "rad, rad, mm", "the joints last told, NaN as a motion begins")
    told: int = whole("ns", "when that was")
    slope: Floats = reals(2, "s, 1", "Σ behind × speed and Σ speed², in greatest speeds")
    lag: float = real("s", "T as the last whole motion told it, 0 before")


@compiled
def forget_lag(d: DriveLag) -> None:
    """Nothing measured."""
    fill(d.behind, 0.0)
    fill(d.joints, 0.0)
    fill(d.slope, 0.0)
    d.told, d.lag = 0, 0.0


@compiled
def begin_lag(d: DriveLag) -> None:
    """A motion begins, at rest."""
    fill(d.behind, 0.0)
    fill(d.joints, np.nan)
    fill(d.slope, 0.0)


@compiled
def follow_drives(
    d: DriveLag, q: Floats, time: int, applied: Floats, fastest: Floats | Point
) -> None:
    """Take in the joints q (3,) told at `time` ns, and the rates (3,) that the arm took since those
    before; `fastest` are the greatest.
    """
    dt = (time - d.told) * 1e-9
    if all_finite(d.joints) and dt > 0.0:
        for i in range(3):
            moved = q[i] - d.joints[i]
            more, speed = applied[i] * dt - moved, moved / dt / fastest[i]
            d.slope[0] += (d.behind[i] + 0.5 * more) / fastest[i] * speed
            d.slope[1] += speed * speed
            d.behind[i] += more
    put(d.joints, q)
    d.told = time


@compiled
def measure_lag(d: DriveLag) -> None:
    """The motion is over: what T it tells, where it can be one."""
    lag = d.slope[0] / d.slope[1] if d.slope[1] > 0.0 else np.nan
    if AHEAD <= lag <= LONGEST:
        d.lag = max(lag, SHORTEST)


@compiled
def lag_so_far(d: DriveLag, known: float) -> float:
    """T in s: as `known`, or where that is 0 as the motion that is under way tells it; 0 where
    nothing has moved yet.
    """
    if known > 0.0:
        return known
    return min(max(d.slope[0] / d.slope[1], 0.0), LONGEST) if d.slope[1] > 0.0 else 0.0


@compiled
def lag_of(d: DriveLag, known: float) -> float:
    """T in s: as `known`, or where that is 0 as measured."""
    if known > 0.0:
        return known
    return d.lag if d.lag > 0.0 else SUPPOSED
