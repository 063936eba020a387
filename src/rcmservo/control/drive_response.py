"""Measurement of how the drives follow the commanded joint rates: gain of each joint, and lag.

A joint with the gain g and the time constant T, which moves by y while the integral of its
commanded rate is U, obeys

    y = g U − T v + c,    v = dy/dt

g and T of each joint are the solution by least squares over a motion to and fro. c is zero, or
solved for too if the joints moved already when the measurement began. A delay has the
same effect as T while the rate changes slowly. One T then serves all joints: its mean, weighted by
their squared speeds in units of their maximal ones. A reading that repeats the last one, as of an
arm that reports more often than it measures, is skipped.
"""

import numpy as np

from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, compute_norm, copy_into, fill
from rcmservo.numerics.structs import Row, flag, real, reals, whole

DEFAULT_LAG_S = 0.025
"""Lag (s) that is assumed before a measurement."""

MAX_LAG_S = 0.2
"""Largest lag (s) of a drive that still counts as following."""

MIN_LAG_S = 0.001
"""Lag (s) that is reported for drives without any measurable lag."""

MIN_MEASURED_LAG_S = -0.02
"""Smallest valid measurement (s). It is negative, as joints that are read late seem to lead."""

MIN_GAIN, MAX_GAIN = 0.6, 1.4
"""Gains of a drive that still counts as following."""

EXACT_GAIN = 0.01
"""Difference from 1 up to which a gain counts as 1: the measurement is no better."""

MAX_CORRELATION = 0.95
"""Squared correlation of U and v from which they do not determine g and T."""

UU, UV, VV, UY, VY, U_SUM, V_SUM, Y_SUM = range(8)
"""Columns of `ResponseMeasurement.sums`."""


class ResponseMeasurement(Row):
    """Running measurement of gains and lag."""

    commanded: Floats = reals(3, "rad, rad, mm", "U: integral of the applied rates")
    commanded_at_reading: Floats = reals(3, "rad, rad, mm", "U at the previous reading")
    ticked_at: int = whole("ns", "time up to which U is integrated")
    moved: Floats = reals(3, "rad, rad, mm", "y: motion of the joints")
    newest_joints: Floats = reals(
        3, "rad, rad, mm", "joints at the previous reading, NaN at the start of a motion"
    )
    read_at: int = whole("ns", "time of the previous reading")
    readings: float = real("", "number of readings in motion, inf if it began at rest")
    sums: Floats = reals((3, 8), "", "Σ UU, Uv, vv, Uy, vy, U, v, y of each joint")
    gains: Floats = reals(3, "", "g of each joint, 0 before a measurement")
    lag: float = real("s", "T by the last complete motion, 0 before")
    is_measuring: bool = flag("a measurement has begun and has not ended")


@compiled
def reset_response(drives: ResponseMeasurement) -> None:
    """Reset the measurement and its result."""
    start_response_measurement(drives)
    fill(drives.newest_joints, 0.0)
    fill(drives.gains, 0.0)
    drives.read_at, drives.ticked_at, drives.lag = 0, 0, 0.0
    drives.is_measuring = False


@compiled
def start_response_measurement(drives: ResponseMeasurement) -> None:
    """Start a measurement with the arm at rest."""
    fill(drives.commanded, 0.0)
    fill(drives.commanded_at_reading, 0.0)
    fill(drives.moved, 0.0)
    fill(drives.newest_joints, np.nan)
    fill(drives.sums, 0.0)
    drives.readings, drives.is_measuring = 0.0, True


@compiled
def add_response_reading(
    drives: ResponseMeasurement, q: Floats, time: int, applied: Floats
) -> None:
    """Add a reading q (3,) at `time` ns, and the rates `applied` (3,) since the previous tick."""
    if not all_finite(drives.newest_joints):
        copy_into(drives.newest_joints, q)
        drives.read_at = drives.ticked_at = time
        drives.readings = 0.0 if compute_norm(applied) > 0.0 else np.inf
        return
    for i in range(3):
        drives.commanded[i] += applied[i] * max(time - drives.ticked_at, 0) * 1e-9
    drives.ticked_at = time
    dt = (time - drives.read_at) * 1e-9
    if not dt > 0.0 or are_equal(q, drives.newest_joints):
        return
    drives.readings += 1.0
    for i in range(3):
        U = 0.5 * (drives.commanded_at_reading[i] + drives.commanded[i])
        motion = q[i] - drives.newest_joints[i]
        y, v, sums = drives.moved[i] + 0.5 * motion, motion / dt, drives.sums[i]
        sums[UU] += U * U
        sums[UV] += U * v
        sums[VV] += v * v
        sums[UY] += U * y
        sums[VY] += v * y
        sums[U_SUM] += U
        sums[V_SUM] += v
        sums[Y_SUM] += y
        drives.moved[i] += motion
    copy_into(drives.commanded_at_reading, drives.commanded)
    copy_into(drives.newest_joints, q)
    drives.read_at = time


@compiled
def are_equal(q: Floats, other: Floats) -> bool:
    """Return True if all joints are equal to the last bit."""
    return q[0] == other[0] and q[1] == other[1] and q[2] == other[2]


@compiled
def compute_moments(
    drives: ResponseMeasurement, i: int
) -> tuple[float, float, float, float, float]:
    """Return the sums of UU, Uv, vv, Uy and vy of joint i, centred unless c is zero."""
    sums, n = drives.sums[i], max(drives.readings, 1.0)
    U, v, y = sums[U_SUM], sums[V_SUM], sums[Y_SUM]
    return (
        sums[UU] - U * U / n,
        sums[UV] - U * v / n,
        sums[VV] - v * v / n,
        sums[UY] - U * y / n,
        sums[VY] - v * y / n,
    )


@compiled
def compute_gain(drives: ResponseMeasurement, i: int) -> float:
    """Return the gain g of joint i by the motion so far; NaN if it does not determine g."""
    uu, uv, vv, uy, vy = compute_moments(drives, i)
    product, squared = uu * vv, uv * uv
    if not squared < MAX_CORRELATION * product:
        return np.nan
    return (uy * vv - vy * uv) / (product - squared)


@compiled
def store_gain(drives: ResponseMeasurement, i: int) -> None:
    """Store the gain of joint i by the motion so far if it is known; 0 if it is not valid."""
    gain = compute_gain(drives, i)
    if np.isfinite(gain):
        is_valid, is_exact = MIN_GAIN <= gain <= MAX_GAIN, abs(gain - 1.0) <= EXACT_GAIN
        drives.gains[i] = (1.0 if is_exact else gain) if is_valid else 0.0


@compiled
def select_gain(drives: ResponseMeasurement, i: int) -> float:
    """Return the gain of joint i, 1 before a measurement."""
    return drives.gains[i] if drives.gains[i] > 0.0 else 1.0


@compiled
def compute_lag(drives: ResponseMeasurement, max_rates: Floats | Point) -> float:
    """Return T in s by the motion so far; NaN without any motion."""
    error_times_speed, squared_speed = 0.0, 0.0
    for i in range(3):
        _, uv, vv, _, vy = compute_moments(drives, i)
        unit = max_rates[i] * max_rates[i]
        error_times_speed += (select_gain(drives, i) * uv - vy) / unit
        squared_speed += vv / unit
    return error_times_speed / squared_speed if squared_speed > 0.0 else np.nan


@compiled
def finish_response_measurement(drives: ResponseMeasurement, max_rates: Floats | Point) -> None:
    """Finish the measurement at the end of a motion, and store g and T where they are valid.

    `max_rates` (3,) are the maximal joint rates.
    """
    drives.is_measuring = False
    for i in range(3):
        store_gain(drives, i)
    lag = compute_lag(drives, max_rates)
    if MIN_MEASURED_LAG_S <= lag <= MAX_LAG_S:
        drives.lag = max(lag, MIN_LAG_S)


@compiled
def estimate_lag_so_far(
    drives: ResponseMeasurement, known_lag: float, max_rates: Floats | Point
) -> float:
    """Return T in s: `known_lag`, or if that is 0 the value by the motion so far, 0 at first."""
    if known_lag > 0.0:
        return known_lag
    lag = compute_lag(drives, max_rates)
    return min(max(lag, 0.0), MAX_LAG_S) if np.isfinite(lag) else 0.0


@compiled
def select_lag(drives: ResponseMeasurement, known_lag: float) -> float:
    """Return T in s: `known_lag`, or if that is 0 the measured or the default value."""
    if known_lag > 0.0:
        return known_lag
    return drives.lag if drives.lag > 0.0 else DEFAULT_LAG_S


@compiled
def select_possible_response(
    drives: ResponseMeasurement, i: int, k: int, known_lag: float
) -> tuple[float, float]:
    """Return the k-th possible (g, T) of joint i, k from 0 to 3.

    All are the measured or default one; during a measurement they are the most extreme valid ones.
    """
    lag_s = select_lag(drives, known_lag)
    if not drives.is_measuring:
        return select_gain(drives, i), lag_s
    gain = MAX_GAIN if k % 2 == 0 else MIN_GAIN
    return gain, lag_s if k < 2 or known_lag > 0.0 else MAX_LAG_S
