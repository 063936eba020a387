"""Mode of a tick, what is forgotten with it, and the command that the gate lets through."""

import numpy as np

from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import put
from rcmservo.safety.causes import ACTIONS, Cause, Invalidates, gravest, invalidated_by
from rcmservo.safety.gate import admit, stop
from rcmservo.safety.monitor_state import unwatch
from rcmservo.safety.state_machine import (
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
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.kernel_parameters import TickContext, rcm_of
from rcmservo.servo.reset import forget, forget_but_places, restart, stand
from rcmservo.servo.state import Stored
from rcmservo.servo.update_estimate import BELIEVED

NOT_FINITE = Cause.NOT_FINITE.place
ESTIMATE, TARGETS = int(Invalidates.ESTIMATE), int(Invalidates.ESTIMATE_AND_TARGETS)


@compiled
def choose_mode(tick: TickContext, causes: int, news: int) -> bool:
    """Enter the mode that follows from the set of `causes`; return whether the estimate is
    forgotten with it. In JOG the operator's joint rates replace the law's.
    """
    s, observation, setpoint = tick.stored, tick.observation, tick.setpoint
    signs = Signs(observation.enabled, s.watch.believed >= 0, news >= BELIEVED, s.tour.done)
    request, now, t = setpoint.request, observation.now, tick.parameters.thresholds
    forgotten = enter(s, causes, signs, request, now, t)
    if s.decision.mode.phase == JOG:
        stand(s.decision)
        put(s.decision.rates, setpoint.jog)
    return forgotten


@compiled
def enter(s: Stored, found: int, signs: Signs, request: int, now: int, t: Thresholds) -> bool:
    """Into the next mode. A pause or fault forgets what it must not go on with; whether that is
    the estimate.
    """
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
def unlearn(s: Stored, cause: int, now: int) -> bool:
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
def bound_rates(tick: TickContext) -> bool:
    """Make the joint rates a command by the gate, at the speed that the mode allows; return whether
    the estimate is forgotten, as a number was not finite there.
    """
    d, now, gate = tick.stored.decision, tick.observation.now, tick.parameters.gate
    share = speed_share(d.mode.phase, d.mode.asks)
    if not share > 0.0:
        stand(d)
    if d.mode.phase in (FAULT, DISABLED):
        stop(d.command, now, gate)
        return False
    rcm = rcm_of(tick.parameters)
    if admit(d.command, d.rates, tick.observation.q, rcm, now, share, gate):
        return False
    return fail(tick.stored, now)


@compiled
def fail(s: Stored, now: int) -> bool:
    """Enter FAULT after the gate replaced a number that is not finite by zero; return whether the
    estimate is forgotten.
    """
    enter_fault(s.decision.mode, NOT_FINITE, now)
    s.decision.command.enabled = False
    forgotten = unlearn(s, NOT_FINITE, now)
    restart(s.decision, now)
    return forgotten
