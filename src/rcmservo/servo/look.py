"""What a tick brings: a new frame, and whether it is believed."""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.guard.checks.drift import watch_drift, watch_stuck
from rcmservo.guard.plausible import leapt, lost, misplaced
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Watch, stays, watch_frame, watch_loop, watch_markers
from rcmservo.interfaces import Floats, ObservationStruct
from rcmservo.loops import distance, put
from rcmservo.memory import scratch, scratch_table
from rcmservo.method.drive_lag import lag_of
from rcmservo.method.foresight import deviation_without, located
from rcmservo.method.kinematics import point_at, reachable
from rcmservo.rows import Rows
from rcmservo.servo.kernel_parameters import KernelParameters, rcm_of, shaft_of
from rcmservo.servo.learn import BELIEVED, LEARN, NOTHING
from rcmservo.servo.state import Estimate, Kept


@compiled
def look(
    rows: Rows[Kept], seen: ObservationStruct, fixed: Rows[KernelParameters]
) -> tuple[int, float]:
    """Keep what this tick shows; what that is, and s since the exposure learnt from before (0 for
    the first)."""
    kept, t, period = rows[0], fixed[0].thresholds, fixed[0].period
    w, e, v, tour, d = kept.watch, kept.estimate, kept.prospect, kept.tour, kept.decision
    gap = seen.now - d.command.time if d.command.number > 0 else period
    watch_loop(w, seen, gap, period, lag_of(tour, t.drive_lag), t)
    if not seen.frame > w.frame:
        return NOTHING, 0.0
    watch_frame(w, seen, t)
    if not reachable(rcm_of(fixed[0]), seen.q_exposure, t.slack):
        return NOTHING, 0.0
    p1, points = scratch(3), scratch_table(2, 2)
    p1[0], p1[1], p1[2] = point_at(rcm_of(fixed[0]), seen.q_exposure)
    put(points, seen.points)
    w.spared = completed(kept, p1, points, fixed[0])
    first, second = lost(points)
    if first or second:
        return NOTHING, 0.0
    if tour.done:
        first, second, crossed = misplaced(v, p1, points, e.points, shaft_of(fixed[0]), t)
        watch_markers(w, first, second, crossed, points, t)
        watch_drift(w, v, p1, points, seen.points, shaft_of(fixed[0]), t)
    else:
        jump = t.jump + t.innovation * np.sqrt(2.0 * v.noise)
        doubt(w, e, seen, p1, jump, t)
    if w.rejected > 0:
        return NOTHING, 0.0
    w.believed = seen.frame
    put(e.points, points)
    put(e.p1, p1)
    teaches = tour.done or not tour.begun or seen.exposure >= tour.start
    news = LEARN if teaches else BELIEVED  # a hand may have moved the tool until then
    return news, (seen.exposure - e.exposure) * 1e-9 if e.exposure >= 0 else 0.0


@compiled
def completed(kept: Kept, p1: Floats, points: Floats, fixed: KernelParameters) -> bool:
    """Put a lost one of the markers (2, 2) raw px where it should be; whether there was one, and
    the other and the joints tell the pose."""
    first, second = lost(points)
    if first == second or not (kept.tour.done and fixed.spares_marker):
        return False
    v, k, shaft = kept.prospect, 0 if first else 1, shaft_of(fixed)
    if not deviation_without(v, p1, k, shaft) <= fixed.thresholds.without_marker:
        return False
    put(points[k], located(v, p1, shaft)[k])
    return True


@compiled
def doubt(
    w: Watch, e: Estimate, seen: ObservationStruct, p1: Floats, jump: float, t: Thresholds
) -> None:
    """While nothing foretells the markers: count a frame as rejected if they leapt by more than
    `jump` px and what the way of the tool to p1 (3,) mm allows, or if one is stuck."""
    way, crossed = distance(p1, e.p1), False
    first, second = watch_stuck(w, p1, seen.points, t)
    if way < t.comparable and not (first or second):
        first, second, crossed = leapt(seen.points, e.points, way, jump, t.nearest)
        if w.jumped > 0 and stays(w, seen.points, t):
            first, second = True, True
    watch_markers(w, first, second, crossed, seen.points, t)
