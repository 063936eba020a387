"""What follows from what a tick brought: the next move of an exploration, the next mode, what is
forgotten with it, and the command."""

from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.guard.causes import ACTIONS, Cause, gravest
from rcmservo.guard.gate import admit, stop
from rcmservo.guard.states import (
    ACQUIRE,
    DISABLED,
    FAULT,
    FAULTED,
    PAUSE,
    PAUSED,
    Signs,
    speed_share,
    transition,
)
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Told, Watch, unwatch, watch_estimate
from rcmservo.interfaces import Floats
from rcmservo.loops import length, minus, put
from rcmservo.method.exploration import Exploring, begin, complete, corner, towards, visit
from rcmservo.method.kinematics import joint_rates, position
from rcmservo.rows import Rows
from rcmservo.servo.decide import decide
from rcmservo.servo.dials import Asked, Fixed, rcm_of
from rcmservo.servo.forget import forget, forget_but_places, restart, stand
from rcmservo.servo.look import BELIEVED, LEARN
from rcmservo.servo.state import Decision, Estimate, Parts

NOT_FINITE, SURPRISED = Cause.NOT_FINITE.place, Cause.SURPRISED.place
CAMERA_MOVED, SWAPPED = Cause.CAMERA_MOVED.place, Cause.SWAPPED.place

UNLEARNT = (
    Cause.DIVERGED.place,
    Cause.NOT_EXPLORED.place,
    Cause.ESTIMATE_LARGE.place,
    Cause.ESTIMATOR_FAILED.place,
    Cause.ESTIMATE_NOT_FINITE.place,
    Cause.NOT_FINITE.place,
)
"""Causes of a pause or fault after which the estimate is learnt anew, beside a moved camera.

After the others it is kept, and with it the newest frame believed, so that a camera moved meanwhile
is noticed.
"""


class Kept(NamedTuple):
    """What a tick changes, but for the estimator's own memory."""

    watch: Rows[Watch]
    """What the checks remember."""
    estimate: Rows[Estimate]
    """What frames have taught, in numbers."""
    tour: Rows[Exploring]
    """Where an exploration stands."""
    decision: Rows[Decision]
    """Mode, wishes and command."""
    lines: Floats
    """The imaged tool's lines that eq. (16) is made of."""


@compiled
def act(
    kept: Kept, news: int, more: int, seen: Told, asked: Asked, fixed: Fixed
) -> tuple[Kept, bool]:
    """What is kept after a tick that brought `news`, with the causes found and `more` of them; and
    whether the estimator must forget all.

    Watch and estimate are this tick's own already; tour and decision are copied.
    """
    tours, decisions, lines = kept.tour.copy(), kept.decision.copy(), kept.lines
    s = Parts(kept.watch[0], kept.estimate[0], tours[0], decisions[0])
    believed, now = news >= BELIEVED, seen.now
    if asked.other:
        restart(s.decision, now)
    if news == LEARN and s.tour.done:
        e, t = s.estimate, fixed.thresholds[0]
        watch_estimate(s.watch, e.p1, e.points, e.o_c, e.J_hat, t)
    if not s.tour.done:
        explore(s, seen, believed, fixed)
    found = decide(s, seen, asked, fixed) | more
    signs = Signs(seen.enabled, believed or s.watch.believed >= 0, believed, s.tour.done)
    forgot = enter(s, found, signs, asked.request, now, fixed.thresholds[0])
    if not send(s.decision, seen, fixed):
        forgot = fail(s, now) or forgot
    if forgot:
        lines = np.zeros_like(lines)
    return Kept(kept.watch, kept.estimate, tours, decisions, lines), forgot


@compiled
def explore(s: Parts, seen: Told, believed: bool, fixed: Fixed) -> None:
    """The first motion: on the tour, until Ĵ predicts what was seen there."""
    tour, d, x, rcm = s.tour, s.decision, fixed.exploration[0], rcm_of(fixed.dials[0])
    if d.phase != ACQUIRE or tour.no_room:
        stand(d)
        return
    if not tour.begun:
        begin(tour, rcm, seen.q, seen.now, fixed.thresholds[0].least_room, x)
        return
    p1 = position(rcm, seen.q)
    if believed and length(minus(p1, corner(tour))) < x.reach:
        visit(tour, s.estimate.p1, s.estimate.points)
        if complete(tour, s.estimate.J_hat, s.estimate.o_c, x):
            tour.done = True
            return
    v = towards(p1, corner(tour), x.speed, x.reach)
    put(d.v, v)
    put(d.rates, joint_rates(rcm, seen.q, v))


@compiled
def enter(s: Parts, found: int, signs: Signs, request: int, now: int, t: Thresholds) -> bool:
    """Into the next mode. A pause or fault forgets what it must not go on with; whether that is
    the estimate."""
    d, before, cause, forgot = s.decision, s.decision.phase, gravest(found), False
    transition(d, found, signs, request, now, t)
    entered = d.phase != before
    if d.phase in (PAUSED, FAULT) and (entered or ACTIONS[cause] == PAUSE):
        forgot = unlearn(s, cause if ACTIONS[cause] >= PAUSE else d.cause, now)
    if d.phase == ACQUIRE and before == PAUSED and not s.tour.done:
        forget_but_places(s)
        forgot = True
    if entered:
        restart(d, now)
    return forgot


@compiled
def unlearn(s: Parts, cause: int, now: int) -> bool:
    """Begin all counts anew, and forget the estimate if a cause spoils it.

    Without an estimate nobody can tell one false marker from a camera that was moved: then it
    counts as that. Nor can anybody tell whether markers that changed places are wrong now or were
    before.
    """
    explored, d = s.tour.done, s.decision
    moved = cause == CAMERA_MOVED or (cause == SURPRISED and not explored)
    spoilt = moved or cause in UNLEARNT or (cause == SWAPPED and not explored)
    unwatch(s.watch, spoilt)
    d.peak = np.inf
    if moved:
        d.moved = now
    if spoilt:
        forget(s)
    s.tour.begun, s.tour.no_room = False, False
    return spoilt


@compiled
def send(d: Decision, seen: Told, fixed: Fixed) -> bool:
    """Through the gate, at the share of the speed that the mode allows; whether all was finite
    there."""
    share = speed_share(d.phase, d.asks)
    if not share > 0.0:
        stand(d)
    if d.phase in (FAULT, DISABLED):
        stop(d, seen.now, fixed.gate)
        return True
    return admit(d, d.rates, seen.q, rcm_of(fixed.dials[0]), seen.now, share, fixed.gate)


@compiled
def fail(s: Parts, now: int) -> bool:
    """Into the fault that a number is which is not finite: the gate made zero of it."""
    d = s.decision
    d.phase, d.cause, d.since, d.good, d.asks = FAULT, NOT_FINITE, now, 0, FAULTED
    d.on = False
    forgot = unlearn(s, d.cause, now)
    restart(d, now)
    return forgot
