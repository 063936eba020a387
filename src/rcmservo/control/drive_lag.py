"""Measurement of the drives' lag behind the commanded joint rates during a motion.

A joint that follows its commanded rate with a time constant T is behind by T times its speed: this
distance is its following error. A delay has the same effect while the rate changes slowly. T is the
slope of the following error over the speed, by least squares over all joints, each in units of its
maximal speed.
"""

import numpy as np

from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, copy_into, fill
from rcmservo.numerics.structs import Row, real, reals, whole

DEFAULT_LAG_S = 0.025
"""Lag (s) that is assumed before a measurement."""

MAX_LAG_S = 0.2
"""Largest lag (s) of a drive that still counts as following."""

MIN_LAG_S = 0.001
"""Lag (s) that is reported for drives without any measurable lag."""

MIN_MEASURED_LAG_S = -0.02
"""Smallest valid measurement (s). It is negative, as joints that are read late seem to lead."""


class DriveLag(Row):
    """Running measurement of the drives' lag."""

    following_error: Floats = reals(3, "rad, rad, mm", "following error of the joints")
    newest_joints: Floats = reals(
        3, "rad, rad, mm", "joints at the previous reading, NaN at the start of a motion"
    )
    read_at: int = whole("ns", "time of the previous reading")
    regression_sums: Floats = reals(
        2, "s, 1", "Σ error × speed and Σ speed², in units of the maximal speeds"
    )
    lag: float = real("s", "T by the last complete motion, 0 before")


@compiled
def reset_lag(drives: DriveLag) -> None:
    """Reset the measurement and its result."""
    fill(drives.following_error, 0.0)
    fill(drives.newest_joints, 0.0)
    fill(drives.regression_sums, 0.0)
    drives.read_at, drives.lag = 0, 0.0


@compiled
def start_lag_measurement(drives: DriveLag) -> None:
    """Start a measurement with the arm at rest."""
    fill(drives.following_error, 0.0)
    fill(drives.newest_joints, np.nan)
    fill(drives.regression_sums, 0.0)


@compiled
def add_lag_reading(
    drives: DriveLag, q: Floats, time: int, applied: Floats, max_rates: Floats | Point
) -> None:
    """Add one reading of the joints and the rates applied since the previous one.

    The joints q (3,) are read at `time` ns. `applied` (3,) and `max_rates` (3,) are the maximal
    joint rates.
    """
    dt = (time - drives.read_at) * 1e-9
    if all_finite(drives.newest_joints) and dt > 0.0:
        for i in range(3):
            motion = q[i] - drives.newest_joints[i]
            error_step, speed = applied[i] * dt - motion, motion / dt / max_rates[i]
            mean_error = (drives.following_error[i] + 0.5 * error_step) / max_rates[i]
            drives.regression_sums[0] += mean_error * speed
            drives.regression_sums[1] += speed * speed
            drives.following_error[i] += error_step
    copy_into(drives.newest_joints, q)
    drives.read_at = time


@compiled
def finish_lag_measurement(drives: DriveLag) -> None:
    """Finish the measurement at the end of a motion, and store T if it is valid."""
    error_times_speed, squared_speed = drives.regression_sums[0], drives.regression_sums[1]
    lag = error_times_speed / squared_speed if squared_speed > 0.0 else np.nan
    if MIN_MEASURED_LAG_S <= lag <= MAX_LAG_S:
        drives.lag = max(lag, MIN_LAG_S)


@compiled
def estimate_lag_so_far(drives: DriveLag, known_lag: float) -> float:
    """Return T in s: `known_lag`, or if that is 0 the value by the motion so far, 0 at first."""
    if known_lag > 0.0:
        return known_lag
    error_times_speed, squared_speed = drives.regression_sums[0], drives.regression_sums[1]
    return min(max(error_times_speed / squared_speed, 0.0), MAX_LAG_S) if squared_speed > 0 else 0.0


@compiled
def select_lag(drives: DriveLag, known_lag: float) -> float:
    """Return T in s: `known_lag`, or if that is 0 the measured or the default value."""
    if known_lag > 0.0:
        return known_lag
    return drives.lag if drives.lag > 0.0 else DEFAULT_LAG_S
