"""Latency of the camera and lag of the drives, identified from a motion.

The pixels m of a marker depend on the joint q at the time of the exposure. For a short motion of
one joint, m = B q(t + δ) + c, where t is the reported exposure time and δ its error. The latency of
the camera is the reported latency less δ. With backlash b the tool follows the motor within a gap:
q is max(q₋, motor) in an upward motion and min(q₋, motor + b) in a downward one, where q₋ is the
joint of the tool before. The motion identifies δ and b together.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from rcmservo.bringup.findings import Finding
from rcmservo.bringup.observations import MotionTrace
from rcmservo.control.drive_response import (
    ResponseMeasurement,
    add_response_reading,
    finish_response_measurement,
    start_response_measurement,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.least_squares import fit_residuals

MAX_TIME_ERROR = 0.3
"""Largest error (s) of reported exposure times that can be identified."""
MIN_FRAMES = 20
"""Smallest number of frames with both markers for an identification."""
LATENCY_TOLERANCE, LATENCY_DEVIATIONS = 0.005, 4.0
"""Tolerated error of a latency, in s and in standard deviations; the larger one counts."""
MIN_LATENCY = 0.001
"""Smallest latency (s) that a corrected line of the rig file holds."""
LAG_TOLERANCE = 0.01
"""Tolerated error (s) of a drive lag."""


@dataclass(frozen=True)
class Cadence:
    """Rate and jitter of a sequence of events.

    Parameters
    ----------
    rate : float
        Mean rate in 1/s.
    jitter : float
        Standard deviation (s) of the time between consecutive events.
    """

    rate: float
    jitter: float


@dataclass(frozen=True)
class CameraLatency:
    """Latency of frames, from the middle of the exposure to the arrival.

    Parameters
    ----------
    latency : float
        Latency (s) identified from a motion.
    reported : float
        Latency (s) by the timestamps of the frames.
    deviation : float
        Standard deviation (s) of `latency`.
    jitter : float
        Standard deviation (s) of the reported latencies.
    """

    latency: float
    reported: float
    deviation: float
    jitter: float


def measure_cadence(times: list[int]) -> Cadence:
    """Return rate and jitter of events at `times` (ns)."""
    intervals_s = np.diff(np.array(times)) * 1e-9
    return Cadence(1.0 / float(np.mean(intervals_s)), float(np.std(intervals_s)))


def identify_latency(trace: MotionTrace, joint: int) -> CameraLatency | None:
    """Identify the latency from a motion of one joint; None if too few frames show both markers."""
    times = np.array([time for time, _, _ in trace.answers]) * 1e-9
    q = np.array([joints[joint] for _, joints, _ in trace.answers])
    start, end = times[0] + MAX_TIME_ERROR, times[-1] - MAX_TIME_ERROR
    frames = [f for f in trace.frames if np.isfinite(f[2]).all() and start < f[0] * 1e-9 < end]
    if len(frames) < MIN_FRAMES:
        return None
    exposures, arrivals = (np.array([frame[k] for frame in frames]) * 1e-9 for k in (0, 1))
    points = np.array([frame[2].ravel() for frame in frames])
    M = points - points.mean(axis=0)

    @lru_cache(maxsize=2)
    def compute_tool(relative_backlash: float) -> Floats:
        return follow_motor(q, relative_backlash * np.ptp(q))

    def compute_residuals(unknowns: Floats) -> Floats:
        """Return the residuals (n, r) of m = B q(t + δ) + c with the best B and c.

        `unknowns` (n, 2) holds n values of δ in s and of b, relative to the range of the motion.
        """
        tools = [(exposures + shift, compute_tool(float(b))) for shift, b in unknowns]
        Q: Floats = np.array([np.interp(at, times, tool) for at, tool in tools], np.float64)
        Q = Q - Q.mean(axis=1, keepdims=True)
        B = Q @ M / np.maximum((Q**2).sum(axis=1, keepdims=True), 1e-30)
        return (M - Q[:, :, None] * B[:, None]).reshape(len(Q), -1)

    fit = fit_residuals(compute_residuals, np.zeros(2))
    degrees_of_freedom = M.size - 2 * M.shape[1] - 2
    deviation = float(np.sqrt(fit.covariance[0, 0] * fit.misfit / degrees_of_freedom))
    reported = float(np.median(arrivals - exposures))
    jitter = float(np.std(arrivals - exposures))
    return CameraLatency(reported - float(fit.x[0]), reported, deviation, jitter)


def follow_motor(motor: Floats, backlash: float) -> Floats:
    """Return the joint (n,) of the tool behind the `motor` (n,), at first at the same position.

    A negative `backlash` gives the opposite deviation, so that 0 is no bound of a fit.
    """
    return motor + np.copysign(_compute_lost_motion(motor, abs(backlash)), backlash)


@compiled
def _compute_lost_motion(motor: Floats, backlash: float) -> Floats:
    """Return by how much (n,) the joint of the tool is above the motor."""
    lost = np.zeros(len(motor))
    for k in range(1, len(motor)):
        lost[k] = min(max(lost[k - 1] + motor[k - 1] - motor[k], 0.0), backlash)
    return lost


def compare_latency(
    identified: CameraLatency | None, latency: float | None, has_key: bool = True
) -> list[Finding]:
    """Compare the identified latency with that of the rig file in s (None if it has none).

    Without a key `latency` in the rig file, the exposure times of the frames must agree with the
    motion as they are.
    """
    where = "camera.latency" if has_key else "camera"
    if identified is None:
        what, found = "the latency of the camera cannot be measured", "too few frames in motion"
        return [Finding(what, where, found, "both markers in nearly every frame")]
    error, deviation = identified.latency - identified.reported, identified.deviation
    is_accurate = abs(error) <= max(LATENCY_TOLERANCE, LATENCY_DEVIATIONS * deviation)
    if not has_key:
        what, found = "the exposure times of the frames contradict the motion", "as they are"
        shift = "earlier" if error > 0.0 else "later"
        expected = f"{abs(error):.3f} s ± {deviation:.3f} s {shift}: middle of the exposure"
        return [] if is_accurate else [Finding(what, where, found, expected)]
    if latency is None:
        corrected = max(error, MIN_LATENCY)
        what, found = "the rig file has no measured latency of the camera", "none"
    elif not is_accurate:
        corrected, found = latency + error, f"{latency:g} s"
        what = "the latency of the camera differs from the rig file"
    else:
        return []
    line, expected = f"latency = {corrected:.3f}", f"{corrected:.3f} s ± {deviation:.3f} s"
    if corrected < 0.0:
        shift = f"timestamps {-corrected:.3f} s ± {deviation:.3f} s later"
        line, expected = "", f"{shift}: they precede the exposures, which no latency corrects"
    return [Finding(what, where, found, expected, line)]


def identify_drive_lag(trace: MotionTrace, max_rates: Floats) -> float:
    """Return the lag (s) of the joints behind their commands; 0 if the motion is too small.

    `max_rates` (3,) are the limits of the joint rates in rad/s, rad/s, mm/s.
    """
    row: Any = ResponseMeasurement.of().rows[0]
    start_response_measurement(row)
    for time, q, applied in trace.answers:
        add_response_reading(row, q, time, applied)
    finish_response_measurement(row, max_rates)
    return float(row["lag"])


def compare_drive_lag(lag: float, known: float) -> list[Finding]:
    """Compare the measured drive `lag` (s) with that of the rig file (0 if it has none)."""
    if not known > 0.0 or not lag > 0.0 or abs(lag - known) <= LAG_TOLERANCE:
        return []
    what, line = "the lag of the drives differs from the rig file", f"drive_lag = {lag:.3f}"
    return [Finding(what, "thresholds.drive_lag", f"{known:g} s", f"{lag:.3f} s", line)]
