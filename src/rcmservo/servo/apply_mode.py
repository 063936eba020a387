"""Mode of a tick, the resets that it causes, and the command that the gate makes."""

import numpy as np

from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into
from rcmservo.safety.causes import ACTIONS, Cause, Invalidates, find_invalidated, select_most_severe
from rcmservo.safety.gate import make_command, make_stop_command
from rcmservo.safety.monitor_state import reset_monitor
from rcmservo.safety.state_machine import (
    ACQUIRE,
    ACTION_PAUSE,
    DISABLED,
    FAULT,
    JOG,
    PAUSED,
    TransitionInputs,
    advance_mode,
    enter_fault,
    speed_scale,
)
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.kernel_parameters import TickContext, make_rcm_struct
from rcmservo.servo.state import (
    StoredState,
    request_rest,
    reset_estimation,
    reset_estimation_except_markers,
    restart_stall_rule,
)
from rcmservo.servo.update_estimate import FRAME_ACCEPTED

NOT_FINITE = Cause.NOT_FINITE.code
"""Code of the cause of a command that is not finite."""

ESTIMATE, ESTIMATE_AND_TARGETS = int(Invalidates.ESTIMATE), int(Invalidates.ESTIMATE_AND_TARGETS)
"""Codes of the parts that a cause invalidates, in the order of their extent."""


@compiled
def choose_mode(tick: TickContext, causes: int, frame_result: int) -> bool:
    """Enter the mode that follows from the set of `causes`; return True if the estimate was reset.

    In JOG the joint rates of the operator replace those of the controller.
    """
    stored, observation, setpoint = tick.stored, tick.observation, tick.setpoint
    has_frame, is_accepted = stored.monitor.accepted_frame >= 0, frame_result >= FRAME_ACCEPTED
    has_estimate = stored.exploration_state.is_done
    inputs = TransitionInputs(observation.enabled, has_frame, is_accepted, has_estimate)
    request, now, thresholds = setpoint.request, observation.now, tick.parameters.thresholds
    was_reset = enter_mode(stored, causes, inputs, request, now, thresholds)
    if stored.decision.mode.phase == JOG:
        request_rest(stored.decision)
        copy_into(stored.decision.rates, setpoint.jog)
    return was_reset


@compiled
def enter_mode(
    stored: StoredState,
    causes: int,
    inputs: TransitionInputs,
    request: int,
    now: int,
    thresholds: Thresholds,
) -> bool:
    """Enter the next mode of the state machine; return True if the estimate was reset.

    A pause or fault resets the parts of the state that its cause invalidates.
    """
    decision, cause, was_reset = stored.decision, select_most_severe(causes), False
    phase_before = decision.mode.phase
    advance_mode(decision.mode, causes, inputs, request, now, thresholds)
    phase = decision.mode.phase
    has_changed = phase != phase_before
    if phase in (PAUSED, FAULT) and (has_changed or ACTIONS[cause] == ACTION_PAUSE):
        acting_cause = cause if ACTIONS[cause] >= ACTION_PAUSE else decision.mode.cause
        was_reset = invalidate(stored, acting_cause, now)
    if phase == ACQUIRE and phase_before == PAUSED and not stored.exploration_state.is_done:
        reset_estimation_except_markers(stored)
        was_reset = True
    if has_changed:
        restart_stall_rule(decision, now)
    return was_reset


@compiled
def invalidate(stored: StoredState, cause: int, now: int) -> bool:
    """Restart all counts and reset what a cause invalidates; return True if that is the estimate.

    Before exploration has ended, a false marker cannot be distinguished from a moved camera, and it
    invalidates as much. The same holds for markers that exchanged positions, which may be false now
    or may have been false before.
    """
    decision = stored.decision
    invalidated = find_invalidated(cause, stored.exploration_state.is_done)
    resets_estimate = invalidated >= ESTIMATE
    reset_monitor(stored.monitor, resets_estimate)
    decision.reference_error = np.inf
    if invalidated == ESTIMATE_AND_TARGETS:
        decision.camera_moved_at = now
    if resets_estimate:
        reset_estimation(stored)
    stored.exploration_state.has_begun, stored.exploration_state.has_no_room = False, False
    return resets_estimate


@compiled
def bound_rates(tick: TickContext) -> bool:
    """Let the gate make the command from the joint rates, at the speed that the mode allows.

    Return True if the estimate was reset because a number was not finite.
    """
    stored, now, gate = tick.stored, tick.observation.now, tick.parameters.gate
    decision, rcm = stored.decision, make_rcm_struct(tick.parameters)
    scale = speed_scale(decision.mode.phase, decision.mode.action)
    if not scale > 0.0:
        request_rest(decision)
    if decision.mode.phase in (FAULT, DISABLED):
        make_stop_command(decision.command, now, gate)
        return False
    q = tick.observation.q
    if make_command(decision.command, decision.rates, q, rcm, now, scale, gate):
        return False
    return enter_not_finite_fault(stored, now)


@compiled
def enter_not_finite_fault(stored: StoredState, now: int) -> bool:
    """Enter FAULT after the gate replaced a non-finite command by zero.

    Return True if the estimate was reset.
    """
    enter_fault(stored.decision.mode, NOT_FINITE, now)
    stored.decision.command.enabled = False
    was_reset = invalidate(stored, NOT_FINITE, now)
    restart_stall_rule(stored.decision, now)
    return was_reset
