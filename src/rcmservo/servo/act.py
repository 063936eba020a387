"""What follows from what a tick brought: the next move of an exploration, the next mode, what is
forgotten with it, and the command."""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.guard.causes import ACTIONS, Cause, Invalidates, gravest, invalidated_by
from rcmservo.guard.gate import admit, stop
from rcmservo.guard.plausible import sound
from rcmservo.guard.states import (
    ACQUIRE,
    DISABLED,
    FAULT,
    JOG,
    PAUSE,
    PAUSED,
    Signs,
    enter_fault,
    speed_share,
    transition,
)
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import unwatch, watch_estimate
from rcmservo.interfaces import Floats, ObservationStruct
from rcmservo.loops import put
from rcmservo.method.controller import scaled
from rcmservo.method.drive_lag import follow_drives, lag_so_far, measure_lag
from rcmservo.method.exploration import (
    CORNERS,
    arrived,
    begin,
    box,
    disagreement,
    face,
    towards,
)
from rcmservo.method.foresight import features_motion, order
from rcmservo.method.planning import directed, plan
from rcmservo.method.prospect import Prospect, empty
from rcmservo.rows import Rows
from rcmservo.servo.decide import decide
from rcmservo.servo.forget import forget, forget_but_places, restart, stand
from rcmservo.servo.kernel_parameters import Asked, KernelParameters, rcm_of, shaft_of
from rcmservo.servo.learn import BELIEVED, LEARN
from rcmservo.servo.state import Decision, Kept

NOT_FINITE = Cause.NOT_FINITE.place
ESTIMATE, TARGETS = int(Invalidates.ESTIMATE), int(Invalidates.ESTIMATE_AND_TARGETS)

SURELY = 0.5
"""Share of its limit that the condition of eq. (16) has at most at the end of an exploration: it
must stay known."""


@compiled
def act(
    kept: Rows[Kept],
    news: int,
    failed: bool,
    seen: ObservationStruct,
    asked: Asked,
    rows: Rows[KernelParameters],
) -> bool:
    """Keep what follows from a tick that brought `news`, at which a user's estimator may have
    `failed`; whether the estimator must forget all."""
    s, fixed = kept[0], rows[0]
    believed, now = news >= BELIEVED, seen.now
    if asked.other:
        restart(s.decision, now)
    if news == LEARN and s.tour.done and s.estimate.rcm_condition > 0.0:
        e, t = s.estimate, fixed.thresholds
        watch_estimate(s.watch, e.p1, e.points, e.o_c, e.J_hat, t)
    if not s.tour.done:
        explore(s, s.prospect, seen, news, asked.points, fixed)
    found = decide(s, seen, asked, failed, fixed)
    signs = Signs(seen.enabled, believed or s.watch.believed >= 0, believed, s.tour.done)
    forgot = enter(s, found, signs, asked.request, now, fixed.thresholds)
    if s.decision.mode.phase == JOG:
        stand(s.decision)
        put(s.decision.rates, asked.jog)
    if not send(s.decision, seen, fixed):
        forgot = fail(s, now) or forgot
    if forgot:
        empty(s.prospect)
    return forgot


@compiled
def explore(
    s: Kept,
    v: Prospect,
    seen: ObservationStruct,
    news: int,
    target: Floats,
    fixed: KernelParameters,
) -> None:
    """The first motion: on the tour, until the estimate is known well enough to go to the `target`
    (2, 2) raw px."""
    tour, d, x, fastest = s.tour, s.decision, fixed.exploration, fixed.gate.speed
    if d.mode.phase != ACQUIRE or tour.no_room:
        stand(d)
        return
    if not tour.begun:
        room = fixed.thresholds.least_room
        begin(tour, rcm_of(fixed), fastest, seen.q, seen.now, room, x)
        return
    follow_drives(tour, seen.q, seen.q_time, seen.applied, fastest)
    if news == LEARN and known(s, v, target, fixed):
        tour.done = True
        measure_lag(tour)
        return
    if arrived(tour, seen.q):
        visit(s, v, seen.q, target, fixed)
    lag = lag_so_far(tour, fixed.thresholds.drive_lag)
    put(d.rates, towards(tour, fastest, seen.q, lag, x))


@compiled
def visit(s: Kept, v: Prospect, q: Floats, target: Floats, fixed: KernelParameters) -> None:
    """The joints q (3,) are at a corner: on to the round's next one, or, once the least number is
    visited, to that which tells most of the way to the `target` (2, 2) raw px."""
    tour, x = s.tour, fixed.exploration
    tour.visits += 1
    if tour.visits % len(CORNERS) == 0:
        box(tour, rcm_of(fixed), fixed.gate.speed, 0.0, x)
    face(tour)
    if tour.visits >= x.legs and not directed(v, s.estimate.p1, target, shaft_of(fixed), x):
        plan(tour, v, rcm_of(fixed), shaft_of(fixed), q, target, x.reach)


@compiled
def known(s: Kept, v: Prospect, target: Floats, fixed: KernelParameters) -> bool:
    """Whether there is an estimate to servo with: the direction to the `target` (2, 2) raw px is
    certain enough, an Ĵ that is not made of the fit agrees with it, and the markers stand in their
    order."""
    e, x = s.estimate, fixed.exploration
    if s.tour.visits < x.legs or not directed(v, e.p1, target, shaft_of(fixed), x):
        return False
    if not sound(v, fixed.thresholds):
        return False
    if not e.rcm_condition <= SURELY * fixed.imaged_rcm.max_condition:
        return False
    if e.rcm_condition > 0.0:
        J = scaled(features_motion(v, e.p1, e.points, e.o_c, shaft_of(fixed)))
        if not disagreement(scaled(e.J_hat), J) <= x.tolerance:
            return False
    return order(v) > 0.0


@compiled
def enter(s: Kept, found: int, signs: Signs, request: int, now: int, t: Thresholds) -> bool:
    """Into the next mode. A pause or fault forgets what it must not go on with; whether that is
    the estimate."""
    d, before, cause, forgot = s.decision, s.decision.mode.phase, gravest(found), False
    transition(d.mode, found, signs, request, now, t)
    entered = d.mode.phase != before
    if d.mode.phase in (PAUSED, FAULT) and (entered or ACTIONS[cause] == PAUSE):
        forgot = unlearn(s, cause if ACTIONS[cause] >= PAUSE else d.mode.cause, now)
    if d.mode.phase == ACQUIRE and before == PAUSED and not s.tour.done:
        forget_but_places(s)
        forgot = True
    if entered:
        restart(d, now)
    return forgot


@compiled
def unlearn(s: Kept, cause: int, now: int) -> bool:
    """Begin all counts anew, and forget what a cause invalidates; whether that is the estimate.

    Without an estimate nobody can tell one false marker from a camera that was moved: then it
    counts as that. Nor can anybody tell whether markers that changed places are wrong now or were
    before.
    """
    d, invalid = s.decision, invalidated_by(cause, s.tour.done)
    spoilt = invalid >= ESTIMATE
    unwatch(s.watch, spoilt)
    d.peak = np.inf
    if invalid == TARGETS:
        d.moved = now
    if spoilt:
        forget(s)
    s.tour.begun, s.tour.no_room = False, False
    return spoilt


@compiled
def send(d: Decision, seen: ObservationStruct, fixed: KernelParameters) -> bool:
    """Through the gate, at the share of the speed that the mode allows; whether all was finite
    there."""
    share = speed_share(d.mode.phase, d.mode.asks)
    if not share > 0.0:
        stand(d)
    if d.mode.phase in (FAULT, DISABLED):
        stop(d.command, seen.now, fixed.gate)
        return True
    return admit(d.command, d.rates, seen.q, rcm_of(fixed), seen.now, share, fixed.gate)


@compiled
def fail(s: Kept, now: int) -> bool:
    """Into the fault that a number is which is not finite: the gate made zero of it."""
    d = s.decision
    enter_fault(d.mode, NOT_FINITE, now)
    d.command.enabled = False
    forgot = unlearn(s, d.mode.cause, now)
    restart(d, now)
    return forgot
