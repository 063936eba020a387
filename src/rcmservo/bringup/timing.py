"""Latency of the camera and lag of the drives, identified from a motion.

The picture of a moving marker shows the joints at its exposure. With m = B q(t + δ) + c for one
joint and a short motion, δ is the error of the reported exposure times. The latency of the camera
is the reported one less δ.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo.bringup.findings import Finding
from rcmservo.bringup.identification import fit_residuals
from rcmservo.bringup.observations import MotionTrace
from rcmservo.control.drive_lag import DriveLag, begin_lag, follow_drives, measure_lag
from rcmservo.interfaces import Floats

MAX_TIME_ERROR = 0.3
"""Largest error (s) of reported exposure times."""
MIN_FRAMES = 20
"""Frames that such a motion must have."""
LATENCY_TOLERANCE, LATENCY_DEVIATIONS = 0.005, 4.0
"""Error (s) that a latency may have, or in standard deviations."""
MIN_LATENCY = 0.001
"""Least latency (s) of a line of the file."""
LAG_TOLERANCE = 0.01
"""Error (s) that a drive lag may have."""


@dataclass(frozen=True)
class Cadence:
    """Rate and evenness of a sequence of events.

    Parameters
    ----------
    rate : float
        1/s.
    jitter : float
        Standard deviation of the time from one to the next, s.
    """

    rate: float
    jitter: float


@dataclass(frozen=True)
class CameraLatency:
    """Delay of frames, from the middle of an exposure to the arrival.

    Parameters
    ----------
    latency : float
        Delay (s) identified from the motion.
    reported : float
        Delay (s) that the frames themselves report.
    deviation : float
        Standard deviation of the first, s.
    jitter : float
        Standard deviation of the reported delays, s.
    """

    latency: float
    reported: float
    deviation: float
    jitter: float


def cadence(times: list[int]) -> Cadence:
    """Return the cadence of events at these times (ns)."""
    apart = np.diff(np.array(times)) * 1e-9
    return Cadence(1.0 / float(np.mean(apart)), float(np.std(apart)))


def identify_latency(trace: MotionTrace, joint: int) -> CameraLatency | None:
    """Identify the latency from a motion of one joint; None if too few frames show it."""
    times = np.array([time for time, _, _ in trace.answers]) * 1e-9
    q = np.array([joints[joint] for _, joints, _ in trace.answers])
    first, last = times[0] + MAX_TIME_ERROR, times[-1] - MAX_TIME_ERROR
    frames = [f for f in trace.frames if np.isfinite(f[2]).all() and first < f[0] * 1e-9 < last]
    if len(frames) < MIN_FRAMES:
        return None
    exposed, arrived = (np.array([frame[k] for frame in frames]) * 1e-9 for k in (0, 1))
    points = np.array([frame[2].ravel() for frame in frames])
    M = points - points.mean(axis=0)

    def residuals(shifts: Floats) -> Floats:
        """Return what m = B q(t + δ) + c leaves of the markers with the best B and c, for every δ
        of some (n, 1).
        """
        Q: Floats = np.asarray(np.interp(exposed + shifts, times, q), np.float64)
        Q = Q - Q.mean(axis=1, keepdims=True)
        B = Q @ M / np.maximum((Q**2).sum(axis=1, keepdims=True), 1e-30)
        return (M - Q[:, :, None] * B[:, None]).reshape(len(Q), -1)

    fit = fit_residuals(residuals, np.zeros(1))
    freedom = M.size - 2 * M.shape[1] - 1
    deviation = float(np.sqrt(fit.covariance[0, 0] * fit.misfit / freedom))
    reported = float(np.median(arrived - exposed))
    jitter = float(np.std(arrived - exposed))
    return CameraLatency(reported - float(fit.x[0]), reported, deviation, jitter)


def latency_findings(identified: CameraLatency | None, latency: float | None) -> list[Finding]:
    """Compare the identified latency with that of the file in s, None if it was never measured."""
    if identified is None:
        what, found = "the latency of the camera cannot be measured", "too few frames of a motion"
        return [Finding(what, "camera.latency", found, "both markers in nearly every frame")]
    more, deviation = identified.latency - identified.reported, identified.deviation
    if latency is None:
        right = max(more, MIN_LATENCY)
        what, found = "the latency of the camera was never measured", "none"
    elif abs(more) > max(LATENCY_TOLERANCE, LATENCY_DEVIATIONS * deviation):
        right, found = latency + more, f"{latency:g} s"
        what = "frames have another latency than the rig file says"
    else:
        return []
    line, expected = f"latency = {right:.3f}", f"{right:.3f} s, to {deviation:.3f} s"
    if right < 0.0:
        late = f"stamps {-right:.3f} s later, to {deviation:.3f} s"
        line, expected = "", f"{late}: they lie before the exposures, and no latency corrects that"
    return [Finding(what, "camera.latency", found, expected, line)]


def drive_lag(trace: MotionTrace, fastest: Floats) -> float:
    """Return the lag (s) of the joints behind their commands; 0 if the motion does not show it."""
    row: Any = DriveLag.of().rows[0]
    begin_lag(row)
    for time, q, applied in trace.answers:
        follow_drives(row, q, time, applied, fastest)
    measure_lag(row)
    return float(row["lag"])


def lag_findings(lag: float, known: float) -> list[Finding]:
    """Compare the drive lag (s) of the file, 0 if it has none, with the measured one."""
    if not known > 0.0 or not lag > 0.0 or abs(lag - known) <= LAG_TOLERANCE:
        return []
    what, line = "the drives lag otherwise than the rig file says", f"drive_lag = {lag:.3f}"
    return [Finding(what, "thresholds.drive_lag", f"{known:g} s", f"{lag:.3f} s", line)]
