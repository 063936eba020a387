"""How late frames come and how late the drives follow, as a motion tells it.

The picture of a marker that moves is where the joints were when it was exposed: with m = B q(t + δ)
+ c for one joint and a short way, δ is by how much the told exposure times are wrong. What frames
are late by is what they are told to be late by, less δ.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo.bringup.sights import Track
from rcmservo.bringup.wiring import Finding
from rcmservo.interfaces import Floats
from rcmservo.method.drive_lag import DriveLag, begin_lag, follow_drives, measure_lag

FARTHEST = 0.3
"""s by which told times are wrong at most, as far as is searched,"""
COARSE = 0.005
"""in such steps at first,"""
FINE = 0.0001
"""and in such at last."""
FEWEST = 20
"""Frames that such a motion must have."""
LATE = 0.005
"""s by which a latency may be off,"""
SURE = 4.0
"""and standard deviations."""
LEAST = 0.001
"""s that a line of the file has at least where nobody had measured it."""


@dataclass(frozen=True)
class Rhythm:
    """How often something comes, and how evenly."""

    rate: float
    """1/s."""
    jitter: float
    """s, the standard deviation of the time from one to the next."""


@dataclass(frozen=True)
class Lateness:
    """By how much frames are late."""

    latency: float
    """s from the middle of an exposure to the frame's arrival, as the motion tells it."""
    told: float
    """s, the same as the frames themselves tell it."""
    within: float
    """s, the standard deviation of the first."""
    jitter: float
    """s, that of what frames tell, from one to the next."""


def pace(times: list[int]) -> Rhythm:
    """Of things that came at these moments (ns)."""
    apart = np.diff(np.array(times)) * 1e-9
    return Rhythm(1.0 / float(np.mean(apart)), float(np.std(apart)))


def lateness(track: Track, joint: int) -> Lateness | None:
    """What a motion of one joint to and fro tells of the frames; None where it tells nothing."""
    times = np.array([time for time, _, _ in track.answers]) * 1e-9
    q = np.array([joints[joint] for _, joints, _ in track.answers])
    seen = [frame for frame in track.frames if np.isfinite(frame[2]).all()]
    inside = [f for f in seen if times[0] + FARTHEST < f[0] * 1e-9 < times[-1] - FARTHEST]
    if len(inside) < FEWEST:
        return None
    exposed = np.array([exposure for exposure, _, _ in inside]) * 1e-9
    arrived = np.array([arrival for _, arrival, _ in inside]) * 1e-9
    points = np.array([seen.ravel() for _, _, seen in inside])

    def left_over(shift: float) -> float:
        return _fit(np.interp(exposed + shift, times, q), points)[0]

    best = 0.0
    for reach, step in ((FARTHEST, COARSE), (COARSE, FINE)):
        shifts = best + np.arange(-reach, reach + step / 2.0, step)
        best = float(shifts[np.argmin([left_over(shift) for shift in shifts])])
    square, per_joint = _fit(np.interp(exposed + best, times, q), points)
    rates = np.interp(exposed + best, (times[1:] + times[:-1]) / 2.0, np.diff(q) / np.diff(times))
    noise = np.sqrt(square / (points.size - points.shape[1] * 2))
    speed = np.sqrt((rates**2).sum() * (per_joint**2).sum())
    told = float(np.median(arrived - exposed))
    within = float(noise / speed) if speed > 0.0 else np.inf
    return Lateness(told - best, told, within, float(np.std(arrived - exposed)))


def wrongly_late(late: Lateness, latency: float | None) -> list[Finding]:
    """What is wrong with the latency (s) of the file; None is one that nobody has measured."""
    more = late.latency - late.told
    if latency is None:
        right, what, found = max(more, LEAST), "nobody has measured how late frames are", "none"
    elif abs(more) > max(LATE, SURE * late.within):
        right, what = latency + more, "frames are not as late as they are told to be"
        found = f"{latency:g} s"
    else:
        return []
    expected, line = f"{right:.3f} s, to {late.within:.3f} s", f"latency = {right:.3f}"
    if right < 0.0:
        line, expected = (
            "",
            f"stamps {-right:.3f} s later, to {late.within:.3f} s: they lie before ",
        )
        expected += "the exposures, and no latency mends that"
    return [Finding(what, "camera.latency", found, expected, line)]


def _fit(q: Floats, points: Floats) -> tuple[float, Floats]:
    """The squares that m = B q + c leaves over, and B."""
    Q, M = q - q.mean(), points - points.mean(axis=0)
    B = Q @ M / max(float(Q @ Q), 1e-30)
    return float(((M - np.outer(Q, B)) ** 2).sum()), B


def drive_lag(track: Track, fastest: Floats) -> float:
    """s by which the joints are behind their commands; 0 where the motion does not tell."""
    row: Any = DriveLag.of().rows[0]
    begin_lag(row)
    for time, q, applied in track.answers:
        follow_drives(row, q, time, applied, fastest)
    measure_lag(row)
    return float(row["lag"])
