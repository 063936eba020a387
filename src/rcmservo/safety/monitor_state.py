"""State of the checks from tick to tick: arm, loop, camera, markers and estimate.

The checks compare the joints with the earlier commands, and a new frame with the motion since the
last one.
"""

import numpy as np

from rcmservo.interfaces import Floats, Observation, ObservationStruct
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, length, minus, put
from rcmservo.numerics.structs import Row, Struct, flag, part, real, reals, whole
from rcmservo.safety.innovation import judged, leapt
from rcmservo.safety.thresholds import Thresholds

ZERO_VECTOR = np.zeros(3)
NAN_VECTOR = np.full(3, np.nan)


class ObservationRow(Struct, source=Observation, without=("sizes", "quality")):
    """Observation of a tick, as a row of the state.

    Compiled functions pass a row on without counting references to it.
    """


class Watch(Row):
    """State of the checks."""

    observation: ObservationRow = part(ObservationRow, "observation of this tick")
    reached: Floats = reals(3, "rad, rad, mm", "joint positions predicted from the commands")
    rates: Floats = reals(3, "rad/s, rad/s, mm/s", "joint rates predicted with the drive's lag")
    told: int = whole("ns", "time of the newest joint positions")
    idle: int = whole("ns", "start of the time without a commanded motion, -1 during a motion")
    rest: Floats = reals(3, "rad, rad, mm", "joint positions at rest in this time, NaN before")
    late: int = whole("", "number of successive late ticks")
    gap: int = whole("ns", "time between the last two ticks")
    frame: int = whole("", "number of the newest frame, -1 before the first")
    believed: int = whole("", "number of the newest accepted frame, -1 before the first")
    exposure: int = whole("ns", "exposure time of the newest frame")
    taken: int = whole("ns", "time of the first tick with the newest frame")
    period: float = real("ns", "filtered time between frames, 0 while unknown")
    latency: int = whole("ns", "time from the newest frame's exposure to its first tick")
    spared: bool = flag("True if one marker is lost and the other determines the pose")
    rejected: int = whole("", "number of successive rejected frames")
    jumped: int = whole("", "number of these in which both markers jumped to a steady position")
    swapped: int = whole("", "number of these with each marker at the other's position")
    elsewhere: Floats = reals((2, 2), "px", "markers of the newest rejected frame")
    left: Floats = reals((2, 2), "px", "mean residual of the fit at each marker")
    averaged: int = whole("", "number of frames in this mean")
    off: Floats = reals(2, "px", "norm of this mean, 0 where noise explains it")
    seen: Floats = reals((2, 2), "px", "newest markers that differed from those before")
    foretold: Floats = reals((2, 2), "px", "prediction of the fit for these markers")
    expected: Floats = reals((2, 2), "px", "prediction of the fit for the newest markers")
    frozen: bool = flag("True if the markers did not change although the tool moved")
    stood: Floats = reals(3, "mm", "p₁ of the first frame with these markers")
    anchors: Floats = reals((2, 4), "px", "where each marker stopped, and where the other was then")
    p1: Floats = reals(3, "mm", "position of marker 1 at the last comparison with the estimate")
    points: Floats = reals((2, 2), "px", "markers at this comparison")
    wrong: int = whole("", "number of successive comparisons that contradict the estimate")


def begin() -> Watch:
    """Return the state before the first observation."""
    unknown = dict.fromkeys(("reached", "rest", "elsewhere", "p1", "points", "seen"), np.nan)
    return Watch.of(idle=-1, frame=-1, believed=-1, **unknown)


@compiled
def unwatch(watch: Watch, markers: bool) -> None:
    """Reset the counts of the same arm and camera.

    With ``markers``, reset the counts of the markers too; then no frame counts as accepted.
    """
    watch.late, watch.wrong, watch.averaged, watch.frozen = 0, 0, 0, False
    put(watch.off, ZERO_VECTOR[:2])
    put(watch.p1, NAN_VECTOR)
    if markers:
        watch.rejected, watch.jumped, watch.swapped = 0, 0, 0
        watch.believed, watch.spared = -1, False


@compiled
def followed(
    reached: Floats, rates: Floats, applied: Floats, q: Floats, dt: float, lag: float, forget: float
) -> None:
    """Predict the joints and their rates ``dt`` s later, in place.

    The drives follow the applied rates as first-order systems with the time constant ``lag`` s. The
    prediction converges to the measured joints with the time constant ``forget`` s.

    Parameters
    ----------
    reached, rates : Floats
        Predicted joints and joint rates, (3,); overwritten.
    applied : Floats
        Joint rates that the arm applies, (3,).
    q : Floats
        Measured joints, (3,).
    dt, lag, forget : float
        Times in s.
    """
    decay, correction = np.exp(-dt / lag), min(dt / forget, 1.0)
    for i in range(3):
        lead = rates[i] - applied[i]
        predicted = reached[i] + applied[i] * dt + lead * lag * (1.0 - decay)
        reached[i] = predicted + (q[i] - predicted) * correction
        rates[i] = applied[i] + lead * decay


@compiled
def watch_loop(watch: Watch, gap: int, period: int, lag: float, thresholds: Thresholds) -> None:
    """Update the state of loop and arm at a tick.

    Count late ticks, predict the joints from the commands, and store their rest position.

    Parameters
    ----------
    watch : Watch
        State of the checks; updated.
    gap, period : int
        Time since the last tick, and its nominal value, ns.
    lag : float
        Time constant of the drives, s.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    observation, reached, watch.gap = watch.observation, watch.reached, gap
    watch.late = watch.late + 1 if gap > (1.0 + thresholds.late_share) * period else 0
    if observation.enabled and all_finite(reached):
        applied, dt = observation.applied, max(observation.q_time - watch.told, 0) * 1e-9
        followed(reached, watch.rates, applied, observation.q, dt, lag, thresholds.forget)
    else:
        put(reached, observation.q)
        put(watch.rates, ZERO_VECTOR)
    watch_rest(watch, observation, thresholds)
    watch.told = observation.q_time


@compiled
def store_observation(row: ObservationRow, observation: ObservationStruct) -> None:
    """Copy the observation into a row."""
    row.now, row.q_time, row.enabled = observation.now, observation.q_time, observation.enabled
    row.frame, row.exposure = observation.frame, observation.exposure
    row.arrival, row.dropped = observation.arrival, observation.dropped
    row.recorded = observation.recorded
    put(row.q, observation.q)
    put(row.applied, observation.applied)
    put(row.q_exposure, observation.q_exposure)
    put(row.points, observation.points)


@compiled
def watch_rest(watch: Watch, observation: ObservationRow, thresholds: Thresholds) -> None:
    """Store the rest position of the joints `come_to_rest` s after the last commanded motion."""
    now, delay = observation.now, thresholds.come_to_rest * 1e9
    if not (observation.enabled and length(observation.applied) == 0.0):
        watch.idle = -1
        put(watch.rest, NAN_VECTOR)
    elif watch.idle < 0:
        watch.idle = now
    elif not all_finite(watch.rest) and now - watch.idle >= delay:
        put(watch.rest, observation.q)


@compiled
def watch_frame(watch: Watch, observation: ObservationRow, thresholds: Thresholds) -> None:
    """Update the latency and the low-pass filtered frame period with a new frame.

    A gap between frames enters the period only up to `stale_slow` periods.
    """
    frame, exposure = observation.frame, observation.exposure
    if watch.frame >= 0:
        one, period = (exposure - watch.exposure) / (frame - watch.frame), watch.period
        slow, first = thresholds.stale_slow, thresholds.first_period
        one = min(one, slow * period if period != 0.0 else 1e9 * first)
        watch.period = period + 0.2 * (one - period) if period != 0.0 else one
    watch.frame, watch.exposure, watch.taken = frame, exposure, observation.now
    watch.latency = observation.now - exposure


@compiled
def stays(watch: Watch, points: Floats, thresholds: Thresholds) -> bool:
    """Return True if the markers (2, 2) px are still where the last, rejected frame had them."""
    limit = thresholds.agreement * thresholds.jump
    first, second, _ = leapt(points, watch.elsewhere, 0.0, limit, thresholds.nearest)
    return watch.rejected > 0 and not (first or second)


@compiled
def watch_markers(
    watch: Watch, first: bool, second: bool, crossed: bool, points: Floats, thresholds: Thresholds
) -> None:
    """Count rejected frames, jumps and swaps of the markers with a new frame.

    Both markers have jumped only if their new positions agree from frame to frame: false detections
    do not agree.

    Parameters
    ----------
    watch : Watch
        State of the checks; updated.
    first, second : bool
        True if marker 1, marker 2 is far from its prediction.
    crossed : bool
        True if each marker is at the other's position.
    points : Floats
        Markers, (2, 2) raw px.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    if not (first or second):
        watch.rejected, watch.jumped, watch.swapped = 0, 0, 0
        return
    both = first and second
    steady = watch.rejected == 0 or stays(watch, points, thresholds)
    watch.rejected += 1
    watch.jumped = watch.jumped + 1 if both and steady else (1 if both else 0)
    watch.swapped = watch.swapped + 1 if both and crossed else 0
    put(watch.elsewhere, points)


@compiled
def watch_estimate(
    watch: Watch, p1: Floats, points: Floats, o_c: Floats, J_hat: Floats, thresholds: Thresholds
) -> None:
    """Compare the estimate with the change of the features since the last comparison.

    Parameters
    ----------
    watch : Watch
        State of the checks; updated.
    p1 : Floats
        Position of marker 1, (3,) mm.
    points : Floats
        Markers, (2, 2) raw px.
    o_c : Floats
        Imaged RCM, (2,) raw px.
    J_hat : Floats
        Estimated Jacobian Ĵ, (3, 3).
    thresholds : Thresholds
        Thresholds of the checks.
    """
    if all_finite(watch.p1):
        motion, least, most = minus(p1, watch.p1), thresholds.telling, thresholds.wrong
        verdict = judged(points, watch.points, o_c, J_hat, motion, least, most)
        if verdict < 0:
            return
        watch.wrong = watch.wrong + 1 if verdict == 1 else 0
    put(watch.p1, p1)
    put(watch.points, points)
