"""The compiled parts of a step, in the order in which a tick goes through them.

    look    what a new frame shows, whether it is believed, and where the imaged RCM is
    learn   the new Ĵ, the features, and how well the estimate foretold them
    decide  the law where there is an estimate, and what is wrong, as a set of causes

`look` copies what it changes, the others work on these copies.
"""

from typing import NamedTuple

from rcmservo.compiled import compiled
from rcmservo.guard.causes import Cause
from rcmservo.guard.faults import arm_faults, camera_faults, loop_faults
from rcmservo.guard.plausible import leapt, lost, misplaced
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import (
    Told,
    Watch,
    stays,
    watch_estimate,
    watch_frame,
    watch_loop,
    watch_markers,
)
from rcmservo.interfaces import Floats
from rcmservo.loops import all_finite, largest, length, minus, product, put
from rcmservo.method.controller import control, scaled
from rcmservo.method.features import FEATURES, difference, measured
from rcmservo.method.imaged_rcm import follow
from rcmservo.method.kinematics import Rcm, blocked, position
from rcmservo.rows import Row, Rows, flag, real, reals, whole
from rcmservo.servo.state import Course, Estimate

NOTHING, BELIEVED, LEARN = 0, 1, 2
"""What a tick brought: no frame to believe, one that is believed, or one to learn from too."""

ESTIMATE_NOT_FINITE, RCM_UNKNOWN = Cause.ESTIMATE_NOT_FINITE.bit, Cause.RCM_UNKNOWN.bit
ESTIMATE_LARGE, SINGULAR = Cause.ESTIMATE_LARGE.bit, Cause.SINGULAR.bit
NEARLY_SINGULAR, DIVERGED, STALLED = (
    Cause.NEARLY_SINGULAR.bit,
    Cause.DIVERGED.bit,
    Cause.STALLED.bit,
)
LIMITS = (Cause.JOINT_1_LIMIT.bit, Cause.JOINT_2_LIMIT.bit, Cause.JOINT_3_LIMIT.bit)


class Dials(Row):
    """What the compiled parts know of the servo's boxes."""

    kind: int = whole("", "the mechanism's coordinates")
    zero: float = real("mm", "ρ of marker 1 where the insertion joint reads zero")
    lower: Floats = reals(3, "rad, rad, mm", "the joints' lower limits")
    upper: Floats = reals(3, "rad, rad, mm", "the joints' upper limits")
    fastest: Floats = reals(3, "rad/s, rad/s, mm/s", "bounds on the joint rates")
    gain: float = real("1/s", "k of the law (31)")
    bounds: Floats = reals(FEATURES, "rad, px, px", "b of the potential (32)")
    printed: bool = flag("whether the potential is as printed")
    max_condition: float = real("", "condition of the scaled Ĵ above which the tool stands still")
    max_speed: float = real("mm/s", "cap on |v|")
    refinements: int = whole("", "steps after eq. (16)")
    rcm_printed: bool = flag("whether eq. (16) is as printed")
    rcm_condition: float = real("", "condition of eq. (16) up to which o_c is known")
    period: int = whole("ns", "from tick to tick")


class Situation(NamedTuple):
    """What the compiled parts know of the phase."""

    on: bool
    """Whether the drive should be on."""
    explored: bool
    """Whether there is an estimate to servo with."""
    servoing: bool
    """Whether the servo does: the phase is SERVO."""


@compiled
def rcm_of(c: Dials) -> Rcm:
    """The mechanism and marker 1."""
    lower, upper = c.lower, c.upper
    low, high = (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])
    return Rcm(c.kind, c.zero, low, high)


@compiled
def look(
    watch: Rows[Watch],
    estimate: Rows[Estimate],
    lines: Floats,
    seen: Told,
    explored: bool,
    dials: Rows[Dials],
    thresholds: Rows[Thresholds],
) -> tuple[Rows[Watch], Rows[Estimate], Floats, int, float]:
    """What this tick shows: copies of watch, estimate and lines with it, what it brought, and s
    since the exposure learnt from before (0 for the first)."""
    watch, estimate = watch.copy(), estimate.copy()
    w, e, c, t = watch[0], estimate[0], dials[0], thresholds[0]
    watch_loop(w, seen, c.period, t)
    if not seen.frame > w.frame:
        return watch, estimate, lines, NOTHING, 0.0
    watch_frame(w, seen, t)
    p1 = position(rcm_of(c), seen.q_exposure)
    first, second = lost(seen.points)
    if first or second or not all_finite(p1):
        return watch, estimate, lines, NOTHING, 0.0
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
    watch: Rows[Watch],
    estimate: Rows[Estimate],
    J_hat: Floats,
    target: Floats,
    exposure: int,
    explored: bool,
    thresholds: Rows[Thresholds],
) -> None:
    """Take in the new Ĵ: features and error about the present o_c, to the `target` (2, 2) px."""
    e = estimate[0]
    e.exposure = exposure
    put(e.J_hat, J_hat)
    y, delta = measured(e.points, target, e.o_c)
    put(e.y, y)
    put(e.delta, delta)
    if explored:
        watch_estimate(watch[0], e.p1, e.points, e.o_c, e.J_hat, thresholds[0])


@compiled
def decide(
    watch: Rows[Watch],
    estimate: Rows[Estimate],
    course: Rows[Course],
    seen: Told,
    situation: Situation,
    dials: Rows[Dials],
    thresholds: Rows[Thresholds],
) -> tuple[Rows[Course], int]:
    """A copy of the course as the law wants it, where there is an estimate, and the causes that are
    there at this tick."""
    w, e, c, t = watch[0], estimate[0], dials[0], thresholds[0]
    rcm = rcm_of(c)
    found = arm_faults(w, seen, situation.on, rcm, t) | loop_faults(w, seen, c.period, t)
    found |= camera_faults(w, seen, t)
    if not all_finite(e.J_hat):
        found |= ESTIMATE_NOT_FINITE
    if not situation.explored:
        return course, found
    course = course.copy()
    d = course[0]
    steer(e, d, seen, situation.servoing, c, t)
    return course, found | estimate_faults(w, e, c, t) | way_faults(d, seen.now, c, t)


@compiled
def steer(e: Estimate, d: Course, seen: Told, servoing: bool, c: Dials, t: Thresholds) -> None:
    """The law on Δy + Ĵ (p₁(now) − p₁), and how it gets on."""
    rcm = rcm_of(c)
    put(e.ahead, difference(e.delta, product(e.J_hat, minus(e.p1, position(rcm, seen.q)))))
    v, condition, error = control(
        e.J_hat, e.ahead, c.bounds, c.printed, c.gain, c.max_condition, c.max_speed
    )
    joint, rates = blocked(rcm, seen.q, v, c.fastest, t.limit_horizon, t.limit_share)
    put(d.v, v)
    put(d.rates, rates)
    e.condition, d.blocked = condition, joint
    peak = max(d.peak, error)
    if error < peak - min(t.stall_fall, t.stall_share * peak) or not servoing:
        peak, d.peak_time = error, seen.now
    d.peak = peak


@compiled
def estimate_faults(w: Watch, e: Estimate, c: Dials, t: Thresholds) -> int:
    """What is wrong with the estimate."""
    found = 0 if e.rcm_condition <= c.rcm_condition else RCM_UNKNOWN
    if not largest(scaled(e.J_hat)) <= t.largest:
        found |= ESTIMATE_LARGE
    if not e.condition < c.max_condition:
        found |= SINGULAR
    elif not e.condition < t.nearly_singular * c.max_condition:
        found |= NEARLY_SINGULAR
    if w.wrong >= t.disagreements:
        found |= DIVERGED
    return found


@compiled
def way_faults(d: Course, now: int, c: Dials, t: Thresholds) -> int:
    """What stands in the way to the target."""
    found = LIMITS[d.blocked] if d.blocked >= 0 else 0
    patience = max(t.stall_time, t.stall_gains / c.gain)
    if d.peak > t.stall_error and now - d.peak_time > patience * 1e9:
        found |= STALLED
    return found
