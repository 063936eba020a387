"""Measurement of how the drives follow the commanded joint rates: gain of each joint, and lag.

A joint with the gain g, the time constant T and a delay D, which moves by y while the integral of
its commanded rate u is U, obeys

    y = g U − T v − g D u + c,    v = dy/dt,    u = dU/dt

for short delays. g of each joint is the solution by least squares over a motion to and fro. c is
zero, or solved for too if the joints moved already when the measurement began. Without the term
with u, a delay of 8 ms would increase g by 2 %.

While the rate changes slowly, u is v/g and a delay has the same effect as T. One lag, T + D, then
serves all joints: the mean of that with the measured g, weighted by their squared speeds in units
of their maximal ones. A reading that repeats the last one, as of an arm that reports more often
than it measures, is skipped.
"""

import numpy as np

from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, compute_norm, copy_into, fill
from rcmservo.numerics.small_solvers import solve_3x3
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

MAX_RATE_CORRELATION = 0.999
"""Squared correlation of v and u from which they do not determine the delay; it is then zero."""

U, V, RATE, Y = range(4)
"""Rows and columns of `ResponseMeasurement.products`: U, v, u and y."""


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
    sums: Floats = reals((3, 4), "", "Σ of U, v, u and y of each joint")
    products: Floats = reals((3, 4, 4), "", "Σ of their products")
    gains: Floats = reals(3, "", "g of each joint, 0 before a measurement")
    lag: float = real("s", "T by the last complete motion, 0 before")
    is_measuring: bool = flag("a measurement has begun and has not ended")


@compiled
def start_response_measurement(drives: ResponseMeasurement) -> None:
    """Start a measurement, with the next reading as its first."""
    fill(drives.commanded, 0.0)
    fill(drives.commanded_at_reading, 0.0)
    fill(drives.moved, 0.0)
    fill(drives.newest_joints, np.nan)
    fill(drives.sums, 0.0)
    fill(drives.products, 0.0)
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
        commanded, before = drives.commanded[i], drives.commanded_at_reading[i]
        motion = q[i] - drives.newest_joints[i]
        sample = (
            0.5 * (before + commanded),
            motion / dt,
            (commanded - before) / dt,
            drives.moved[i] + 0.5 * motion,
        )
        for j in range(4):
            drives.sums[i, j] += sample[j]
            for k in range(4):
                drives.products[i, j, k] += sample[j] * sample[k]
        drives.moved[i] += motion
    copy_into(drives.commanded_at_reading, drives.commanded)
    copy_into(drives.newest_joints, q)
    drives.read_at = time


@compiled
def are_equal(q: Floats, other: Floats) -> bool:
    """Return True if all joints are equal to the last bit."""
    return q[0] == other[0] and q[1] == other[1] and q[2] == other[2]


@compiled
def compute_moment(drives: ResponseMeasurement, i: int, j: int, k: int) -> float:
    """Return the sum of products j, k of joint i, centred unless c is zero."""
    n = max(drives.readings, 1.0)
    return drives.products[i, j, k] - drives.sums[i, j] * drives.sums[i, k] / n


@compiled
def compute_gain(drives: ResponseMeasurement, i: int) -> float:
    """Return the gain g of joint i by the motion so far; NaN if it does not determine g."""
    M, b = np.empty((3, 3)), np.empty(3)
    for j in range(3):
        b[j] = compute_moment(drives, i, j, Y)
        for k in range(3):
            M[j, k] = compute_moment(drives, i, j, k)
    if not M[U, V] ** 2 < MAX_CORRELATION * M[U, U] * M[V, V]:
        return np.nan
    if not M[V, RATE] ** 2 < MAX_RATE_CORRELATION * M[V, V] * M[RATE, RATE]:
        return (b[U] * M[V, V] - b[V] * M[U, V]) / (M[U, U] * M[V, V] - M[U, V] ** 2)
    solution, _ = solve_3x3(M, b)
    return solution[0]


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
        unit, gain = max_rates[i] * max_rates[i], select_gain(drives, i)
        error = gain * compute_moment(drives, i, U, V) - compute_moment(drives, i, V, Y)
        error_times_speed += error / unit
        squared_speed += compute_moment(drives, i, V, V) / unit
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
