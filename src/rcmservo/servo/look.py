"""What a tick brings: a new frame, whether it is believed, where the imaged RCM is, and what the
new Ĵ says of it."""

from rcmservo.compiled import compiled
from rcmservo.guard.plausible import leapt, lost, misplaced
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import (
    Told,
    Watch,
    stays,
    watch_frame,
    watch_loop,
    watch_markers,
)
from rcmservo.interfaces import Floats
from rcmservo.loops import length, minus, put
from rcmservo.method.features import measured
from rcmservo.method.imaged_rcm import follow
from rcmservo.method.kinematics import position, reachable
from rcmservo.rows import Rows
from rcmservo.servo.dials import Fixed, rcm_of
from rcmservo.servo.state import Estimate

NOTHING, BELIEVED, LEARN = 0, 1, 2
"""What a tick brought: no frame to believe, one that is believed, or one to learn from too."""


@compiled
def look(
    watch: Rows[Watch],
    estimate: Rows[Estimate],
    lines: Floats,
    seen: Told,
    explored: bool,
    fixed: Fixed,
) -> tuple[Rows[Watch], Rows[Estimate], Floats, int, float]:
    """What this tick shows: copies of watch, estimate and lines with it, what it brought, and s
    since the exposure learnt from before (0 for the first)."""
    watch, estimate = watch.copy(), estimate.copy()
    w, e, c, t = watch[0], estimate[0], fixed.dials[0], fixed.thresholds[0]
    watch_loop(w, seen, c.period, t)
    if not seen.frame > w.frame:
        return watch, estimate, lines, NOTHING, 0.0
    watch_frame(w, seen, t)
    first, second = lost(seen.points)
    if first or second or not reachable(rcm_of(c), seen.q_exposure, t.slack):
        return watch, estimate, lines, NOTHING, 0.0
    p1 = position(rcm_of(c), seen.q_exposure)
    doubt(w, e, seen, minus(p1, e.p1), explored and e.rcm_condition <= c.rcm_condition, t)
    if w.rejected > 0:
        return watch, estimate, lines, NOTHING, 0.0
    w.believed = seen.frame
    lines, count, o_c, condition = follow(
        lines, e.line_count, seen.points, c.refinements, c.rcm_printed
    )
    put(e.points, seen.points)
    put(e.p1, p1)
    put(e.o_c, o_c)
    e.line_count, e.rcm_condition = count, condition
    news = LEARN if condition <= c.rcm_condition else BELIEVED
    dt = (seen.exposure - e.exposure) * 1e-9 if e.exposure >= 0 else 0.0
    return watch, estimate, lines, news, dt


@compiled
def doubt(w: Watch, e: Estimate, seen: Told, way: Floats, foretold: bool, t: Thresholds) -> None:
    """Count a frame as rejected if its markers are not where the motion `way` (3,) mm puts them."""
    first, second, crossed = False, False, False
    if length(way) < t.comparable:
        if foretold:
            first, second, crossed = misplaced(
                seen.points, e.points, e.o_c, e.y, e.J_hat, way, t.jump
            )
        else:
            first, second, crossed = leapt(seen.points, e.points, way, t.jump, t.nearest)
            if w.jumped > 0 and stays(w, seen.points, t):
                first, second = True, True
    watch_markers(w, first, second, crossed, seen.points, t)


@compiled
def learn(
    estimate: Rows[Estimate], J_hat: Floats, points: Floats, target: Floats, exposure: int
) -> None:
    """Take in the new Ĵ: features of the markers' `points` about the present o_c, and the error to
    the `target`, both (2, 2) px."""
    e = estimate[0]
    e.exposure = exposure
    put(e.J_hat, J_hat)
    y, delta = measured(points, target, e.o_c)
    put(e.y, y)
    put(e.delta, delta)
