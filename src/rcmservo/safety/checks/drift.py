"""Whether the picture drifts away from what the joints say, or stands still while they move.

One frame that is wrong is told by its own innovation (innovation.py). A camera that pans, rolls,
zooms or comes nearer, and a likeness that slides along, are wrong by little in every frame: their
mean over a third of a second tells them, with the noise averaged out of it. A picture that is
frozen is the same to the last bit, which no camera delivers of a tool that moves.
"""

import numpy as np

from rcmservo.estimation.projection_fit import Foretold, Prospect, both
from rcmservo.estimation.projection_prediction import spread
from rcmservo.geometry.tool import Shaft
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import distance, length, put
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.innovation import squared
from rcmservo.safety.monitor_state import Watch
from rcmservo.safety.thresholds import Thresholds

OTHERS = 5.0
"""Times as far as a marker that stands still may go, the other must have gone."""

ALONE = 3.0
"""A marker that is so many times as far off as the other may be something else."""


@compiled
def watch_drift(
    w: Watch, v: Prospect, p1: Floats, points: Floats, seen: Floats, shaft: Shaft, t: Thresholds
) -> None:
    """One more frame: raw `points` (2, 2) px, and the same as they were `seen`, NaN where lost,
    with marker 1 at p1 (3,) mm.
    """
    there = both(v, p1, shaft)
    w.averaged = min(w.averaged + 1, t.drift_frames)
    for k in range(2):
        average(w, v, k, there[k], points[k], t)
    same = alike(seen, w.seen)
    moved = distance(p1, w.stood) > t.stuck or farthest(w.expected, w.foretold) > t.drift_px
    w.frozen = same and moved
    if not same:
        put(w.seen, seen)
        put(w.stood, p1)
        put(w.foretold, w.expected)


@compiled
def watch_stuck(w: Watch, p1: Floats, points: Floats, t: Thresholds) -> tuple[bool, bool]:
    """Whether marker 1, marker 2 stands still while the other goes its way, as long as nothing
    foretells them: raw `points` (2, 2) px, with marker 1 at p1 (3,) mm. Where neither changes at
    all while the tool moves, the picture is frozen.
    """
    same, stands = alike(points, w.seen), np.empty(2)
    w.frozen = same and distance(p1, w.stood) > t.stuck
    if not same:
        put(w.seen, points)
        put(w.stood, p1)
    for k in range(2):
        if not distance(points[k], w.anchors[k, :2]) <= t.stuck_px:
            put(w.anchors[k, :2], points[k])
            put(w.anchors[k, 2:], points[1 - k])
        stands[k] = distance(points[1 - k], w.anchors[k, 2:])
    return stands[0] > OTHERS * t.stuck_px, stands[1] > OTHERS * t.stuck_px


@compiled
def average(w: Watch, v: Prospect, k: int, there: Foretold, point: Floats, t: Thresholds) -> None:
    """Take what the fit leaves over of marker k, seen at a raw `point` (2,) px, into the mean, and
    judge that. It counts only up to a bound, so that no mean is made by so few frames as may be
    rejected in a row.
    """
    place = w.expected[k]
    place[0], place[1] = v.origin[3] + there.m[0], v.origin[4] + there.m[1]
    bound = t.drift_px * t.drift_frames / (np.sqrt(2.0) * (t.rejected + 1))
    for i in range(2):
        most = min(max(point[i] - place[i], -bound), bound)
        w.left[k, i] += (most - w.left[k, i]) / w.averaged
    noise, off = v.noise / w.averaged, length(w.left[k])
    surely = off * off <= t.drift**2 * noise  # the fit's own error only adds to what noise explains
    left = w.left[k]
    told = not surely and squared(left[0], left[1], spread(v, there), noise) > t.drift**2
    w.off[k] = off if told else 0.0


@compiled
def alike(one: Floats, other: Floats) -> bool:
    """Whether two (2, 2) are the same, a lost marker being like a lost one."""
    for k in range(2):
        for i in range(2):
            a, b = one[k, i], other[k, i]
            if not (a == b or (np.isnan(a) and np.isnan(b))):
                return False
    return True


@compiled
def farthest(one: Floats, other: Floats) -> float:
    """The largest absolute difference of two (2, 2); NaN if a number is NaN."""
    most = 0.0
    for k in range(2):
        for i in range(2):
            off = abs(one[k, i] - other[k, i])
            if np.isnan(off):
                return np.nan
            most = max(most, off)
    return most


@compiled
def picture_is_frozen(c: TickFacts) -> bool:
    """Detect a picture that stays the same while the tool moves."""
    return c.watch.frozen and not c.tour.no_room


@compiled
def markers_deviate(c: TickFacts) -> bool:
    """Return True if a marker's mean residual is too large."""
    w, t = c.watch, c.thresholds
    judged = c.tour.done and not w.frozen and w.averaged >= t.drift_frames
    return judged and max(w.off[0], w.off[1]) > t.drift_px


@compiled
def one_marker_deviates(c: TickFacts) -> bool:
    """Return True if the mean residual of one marker alone is too large."""
    off = c.watch.off
    return markers_deviate(c) and max(off[0], off[1]) > ALONE * min(off[0], off[1])


@compiled
def markers_drift(c: TickFacts) -> bool:
    """Detect that both markers drift away from where the joints put them."""
    return markers_deviate(c) and not one_marker_deviates(c)
