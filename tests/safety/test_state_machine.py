"""State machine: the greatest action wins, a pause waits for the operator, a fault is latched."""

import functools
import operator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcmservo.numerics.structs import to_row
from rcmservo.safety import state_machine
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import (
    REQUESTS,
    Mode,
    ModeStruct,
    Phase,
    Request,
    TransitionInputs,
)
from rcmservo.safety.thresholds import Thresholds

DEFAULT = Thresholds()
HOLD_TIME_NS = round(1e9 * DEFAULT.hold_time)
FRAMES_TO_RECOVER, FRAMES_TO_SERVO = DEFAULT.frames_to_recover, DEFAULT.frames_to_servo


def transition(mode, present, inputs, request, now):
    """Call the kernel with a `Mode`, a list of causes and a `Request`."""
    causes = functools.reduce(operator.or_, (cause.bit for cause in present), 0)
    row, code = ModeStruct.from_source(mode), REQUESTS.index(request)
    state_machine.advance_mode(row.rows[0], causes, inputs, code, now, to_row(DEFAULT)[0])
    return Mode(**row.values())


def most_severe(present):
    return max(present, key=lambda cause: (cause.action, -cause.code), default=Cause.NONE)


NORMAL = TransitionInputs(
    drive_enabled=True, has_accepted_frame=True, frame_accepted=True, has_estimate=True
)
WEAKEST_TO_STRONGEST = (
    Phase.SERVO,
    Phase.ACQUIRE,
    Phase.IDLE,
    Phase.JOG,
    Phase.HOLD,
    Phase.PAUSED,
    Phase.DISABLED,
    Phase.FAULT,
)
"""Phases from the weakest reaction to the strongest."""

ALL_CAUSES = [cause for cause in Cause if cause is not Cause.NONE]

causes = st.sampled_from(ALL_CAUSES)
some_causes = st.lists(causes, max_size=4)
requests = st.sampled_from(list(Request))
transition_inputs = st.builds(
    TransitionInputs, st.booleans(), st.booleans(), st.booleans(), st.booleans()
)
times = st.integers(0, 10**13)


@st.composite
def modes(draw):
    """Return a mode as the state machine enters it, at some time in the past."""
    phase = draw(st.sampled_from(list(Phase)))
    action = {Phase.HOLD: Action.HOLD, Phase.PAUSED: Action.PAUSE, Phase.FAULT: Action.FAULT}.get(
        phase
    )
    cause = draw(
        causes.filter(
            lambda cause: action is None or cause.action == action or phase is Phase.PAUSED
        )
    )
    weak = draw(st.sampled_from([Action.NONE, Action.WARN, Action.SLOW]))
    return Mode(
        phase, cause, draw(times), draw(st.integers(0, 12)), weak if action is None else action
    )


def strength(mode):
    return WEAKEST_TO_STRONGEST.index(mode.phase), -mode.speed_scale


@settings(max_examples=100)
@given(modes(), some_causes, transition_inputs, requests, times)
def test_no_additional_fault_weakens_the_reaction(mode, present, inputs, operator_request, now):
    """Each example adds every cause: another example takes far longer than another transition."""
    before = strength(transition(mode, present, inputs, operator_request, now))
    for added in ALL_CAUSES:
        after = transition(mode, [*present, added], inputs, operator_request, now)
        assert strength(after) >= before, added


@given(modes(), some_causes, transition_inputs, requests, times, st.randoms())
def test_the_order_of_causes_has_no_effect(mode, present, inputs, operator_request, now, random):
    shuffled = list(present)
    random.shuffle(shuffled)
    assert transition(mode, present, inputs, operator_request, now) == transition(
        mode, shuffled, inputs, operator_request, now
    )


@given(modes(), some_causes, transition_inputs, requests, times)
def test_every_reaction_is_at_least_the_action_of_the_most_severe_cause(
    mode, present, inputs, operator_request, now
):
    action = most_severe(present).action
    after = transition(mode, present, inputs, operator_request, now)
    if action is Action.FAULT:
        assert after.phase is Phase.FAULT
    elif after.phase is Phase.JOG:
        assert operator_request is Request.JOG and Cause.OVERRUN not in present
    elif action >= Action.HOLD:
        assert after.speed_scale == 0.0
    elif action is Action.SLOW:
        assert after.speed_scale <= 0.2
    assert after.speed_scale == 0.0 or after.phase in (Phase.ACQUIRE, Phase.SERVO, Phase.JOG)
    assert after.phase is not Phase.JOG or after.speed_scale == 0.2


@given(modes(), some_causes, transition_inputs, requests, times)
def test_servo_is_entered_only_from_acquire(mode, present, inputs, operator_request, now):
    if transition(mode, present, inputs, operator_request, now).phase is Phase.SERVO:
        assert mode.phase in (Phase.ACQUIRE, Phase.SERVO)


@given(modes(), some_causes, transition_inputs, requests, times)
def test_jogging_starts_from_idle_or_pause_and_lasts_while_it_is_requested(
    mode, present, inputs, operator_request, now
):
    after = transition(mode, present, inputs, operator_request, now)
    if after.phase is Phase.JOG:
        assert operator_request is Request.JOG
        assert mode.phase in (Phase.IDLE, Phase.PAUSED, Phase.JOG)
    elif mode.phase is Phase.JOG:
        assert after.phase in (Phase.PAUSED, Phase.FAULT)


@given(some_causes, some_causes, transition_inputs, requests, times)
def test_only_clear_without_remaining_faults_leaves_a_fault_into_disabled(
    first, present, inputs, operator_request, now
):
    mode = transition(Mode(Phase.SERVO), [Cause.ARM_SILENT, *first], inputs, Request.NONE, 0)
    assert mode.phase is Phase.FAULT
    after = transition(mode, present, inputs, operator_request, now)
    if operator_request is Request.CLEAR and most_severe(present).action < Action.FAULT:
        assert after.phase is Phase.DISABLED
    else:
        assert after == mode


@given(some_causes, transition_inputs, requests, times)
def test_a_pause_ends_by_a_fault_or_by_the_operator(present, inputs, operator_request, now):
    mode = Mode(Phase.PAUSED, Cause.CAMERA_MOVED, 0, 0, Action.PAUSE)
    after = transition(mode, present, inputs, operator_request, now)
    action = most_severe(present).action
    if action is Action.FAULT:
        assert after.phase is Phase.FAULT
    elif operator_request is Request.RESUME and action < Action.HOLD:
        assert after.phase is Phase.ACQUIRE
    elif operator_request is Request.JOG and Cause.OVERRUN not in present:
        assert after.phase is Phase.JOG
    else:
        assert after.phase is Phase.PAUSED


def test_the_first_frames_after_enabling_lead_to_servo():
    mode, phases = Mode(), []
    for now in range(FRAMES_TO_SERVO + 3):
        mode = transition(mode, [], NORMAL, Request.NONE, now)
        phases.append(mode.phase)
    assert phases == [Phase.IDLE, *[Phase.ACQUIRE] * FRAMES_TO_SERVO, Phase.SERVO, Phase.SERVO]
    drive_off = NORMAL._replace(drive_enabled=False)
    assert transition(Mode(), [], drive_off, Request.NONE, 0).phase is Phase.DISABLED
    without_frame = NORMAL._replace(has_accepted_frame=False)
    assert transition(Mode(Phase.IDLE), [], without_frame, Request.NONE, 0).phase is Phase.IDLE


def test_ticks_without_an_accepted_frame_or_an_estimate_do_not_count():
    mode = Mode(Phase.ACQUIRE)
    for inputs in (NORMAL._replace(frame_accepted=False), NORMAL._replace(has_estimate=False)):
        for now in range(3 * FRAMES_TO_SERVO):
            mode = transition(mode, [], inputs, Request.NONE, now)
        assert mode == Mode(Phase.ACQUIRE)


def test_a_hold_recovers_through_acquire_and_a_long_hold_becomes_a_pause():
    held = transition(Mode(Phase.SERVO), [Cause.MARKER_1_LOST], NORMAL, Request.NONE, 0)
    assert (held.phase, held.speed_scale) == (Phase.HOLD, 0.0)
    mode = held
    for now in range(FRAMES_TO_RECOVER):
        assert mode.phase is Phase.HOLD
        mode = transition(mode, [], NORMAL, Request.NONE, now)
    assert mode.phase is Phase.ACQUIRE
    assert (
        transition(held, [Cause.MARKER_1_LOST], NORMAL, Request.NONE, HOLD_TIME_NS).phase
        is Phase.HOLD
    )
    assert (
        transition(held, [Cause.MARKER_2_LOST], NORMAL, Request.NONE, HOLD_TIME_NS + 1).phase
        is Phase.PAUSED
    )


def test_a_cause_of_a_hold_restarts_the_count_of_frames():
    mode = transition(Mode(Phase.SERVO), [Cause.STALE], NORMAL, Request.NONE, 0)
    for now in range(1, FRAMES_TO_RECOVER):
        mode = transition(mode, [], NORMAL, Request.NONE, now)
    mode = transition(mode, [Cause.STALE], NORMAL, Request.NONE, 9)
    assert mode.accepted_frames == 0 and mode.since == 0


def test_slow_and_warn_do_not_change_the_phase():
    slow = transition(Mode(Phase.SERVO), [Cause.AGEING], NORMAL, Request.NONE, 0)
    warned = transition(Mode(Phase.SERVO), [Cause.LATE_TICK], NORMAL, Request.NONE, 0)
    assert (slow.phase, slow.cause, slow.speed_scale) == (Phase.SERVO, Cause.AGEING, 0.2)
    assert (warned.phase, warned.cause, warned.speed_scale) == (Phase.SERVO, Cause.LATE_TICK, 1.0)


def test_the_operator_may_pause_at_any_time():
    mode = transition(Mode(Phase.SERVO), [], NORMAL, Request.PAUSE, 0)
    assert (mode.phase, mode.cause) == (Phase.PAUSED, Cause.ASKED)


def test_a_more_severe_cause_during_a_pause_replaces_the_cause():
    mode = Mode(Phase.PAUSED, Cause.MARKERS_LOST, 0, 0, Action.PAUSE)
    assert transition(mode, [Cause.STALE], NORMAL, Request.NONE, 1).cause is Cause.MARKERS_LOST
    moved = transition(mode, [Cause.CAMERA_MOVED, Cause.TARGET_OLD], NORMAL, Request.NONE, 1)
    assert moved.cause is Cause.CAMERA_MOVED
    assert (
        transition(moved, [Cause.TARGET_OLD], NORMAL, Request.NONE, 2).cause is Cause.CAMERA_MOVED
    )
    assert (
        transition(moved, [Cause.TARGET_OLD], NORMAL, Request.RESUME, 3).cause is Cause.TARGET_OLD
    )


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_has_a_sentence_and_every_stop_a_remedy(cause):
    if cause is Cause.NONE:
        assert not cause.text
    else:
        assert cause.value[0].islower() and not cause.value.endswith(".")
        assert bool(cause.remedy) == (cause.action >= Action.HOLD)
    assert Cause(cause.value) is cause


def test_a_hold_that_recovers_too_late_becomes_a_pause():
    held = Mode(
        Phase.HOLD, Cause.STALE, since=0, accepted_frames=FRAMES_TO_RECOVER - 1, action=Action.HOLD
    )
    assert transition(held, [], NORMAL, Request.NONE, HOLD_TIME_NS).phase is Phase.ACQUIRE
    late = transition(held, [], NORMAL, Request.NONE, HOLD_TIME_NS + 1)
    assert late.phase is Phase.PAUSED and late.cause is Cause.STALE


@pytest.mark.parametrize("cause", Cause)
def test_only_a_cause_that_stops_the_tool_is_stopping(cause):
    after = transition(Mode(Phase.SERVO), [cause], NORMAL, Request.NONE, 1)
    assert bool(cause.stop_sentence) == (after.speed_scale == 0.0)
    assert cause.stop_sentence in ("", cause.value)


@pytest.mark.parametrize("cause", Cause)
def test_only_a_fault_or_a_late_loop_ends_a_jog(cause):
    after = transition(Mode(Phase.JOG), [cause], NORMAL, Request.JOG, 1)
    if cause.action is Action.FAULT:
        assert (after.phase, after.cause) == (Phase.FAULT, cause)
    elif cause is Cause.OVERRUN:
        assert (after.phase, after.cause) == (Phase.PAUSED, cause)
    else:
        assert after == Mode(Phase.JOG, action=Action.SLOW)
