"""The state machine as claims: the greatest action wins, a pause waits for a person, a fault is
latched.
"""

import functools
import operator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcmservo.numerics.structs import as_row
from rcmservo.safety import state_machine
from rcmservo.safety.causes import Action, Cause
from rcmservo.safety.state_machine import (
    REQUESTS,
    Mode,
    ModeStruct,
    Phase,
    Request,
    Signs,
)
from rcmservo.safety.thresholds import Thresholds

USUAL = Thresholds()
HOLD_TIME = round(1e9 * USUAL.hold_time)
GOOD_TO_RECOVER, GOOD_TO_SERVO = USUAL.good_to_recover, USUAL.good_to_servo


def transition(mode, present, sign, request, now):
    """The same in words, with the causes as a list."""
    causes = functools.reduce(operator.or_, (cause.bit for cause in present), 0)
    row, asked = ModeStruct.from_source(mode), REQUESTS.index(request)
    state_machine.transition(row.rows[0], causes, sign, asked, now, as_row(USUAL)[0])
    return Mode(**row.values())


def gravest(present):
    return max(present, key=lambda cause: (cause.action, -cause.place), default=Cause.NONE)


GOOD = Signs(enabled=True, seen=True, good=True, ready=True)
FIRM = (
    Phase.SERVO,
    Phase.ACQUIRE,
    Phase.IDLE,
    Phase.JOG,
    Phase.HOLD,
    Phase.PAUSED,
    Phase.DISABLED,
    Phase.FAULT,
)
"""Phases from the softest answer to the hardest."""

causes = st.sampled_from([cause for cause in Cause if cause is not Cause.NONE])
some_causes = st.lists(causes, max_size=4)
requests = st.sampled_from(list(Request))
signs = st.builds(Signs, st.booleans(), st.booleans(), st.booleans(), st.booleans())
times = st.integers(0, 10**13)


@st.composite
def modes(draw):
    """A mode as transitions make them, some time before now."""
    phase = draw(st.sampled_from(list(Phase)))
    asks = {Phase.HOLD: Action.HOLD, Phase.PAUSED: Action.PAUSE, Phase.FAULT: Action.FAULT}.get(
        phase
    )
    cause = draw(
        causes.filter(lambda cause: asks is None or cause.action == asks or phase is Phase.PAUSED)
    )
    softer = draw(st.sampled_from([Action.NONE, Action.WARN, Action.SLOW]))
    return Mode(
        phase, cause, draw(times), draw(st.integers(0, 12)), softer if asks is None else asks
    )


def firmness(mode):
    return FIRM.index(mode.phase), -mode.share


one_fault_more = given(modes(), some_causes, causes, signs, requests, times)


def never_softer(mode, present, more, sign, request_, now):
    answer = transition(mode, present, sign, request_, now)
    assert firmness(transition(mode, [*present, more], sign, request_, now)) >= firmness(answer)


@settings(max_examples=300)
@one_fault_more
def test_adding_a_fault_never_softens_the_answer(mode, present, more, sign, request_, now):
    never_softer(mode, present, more, sign, request_, now)


@pytest.mark.slow
@settings(max_examples=3_000)
@one_fault_more
def test_adding_any_fault_never_softens_the_answer(mode, present, more, sign, request_, now):
    never_softer(mode, present, more, sign, request_, now)


@given(modes(), some_causes, signs, requests, times, st.randoms())
def test_the_order_in_which_causes_are_told_changes_nothing(
    mode, present, sign, request_, now, random
):
    shuffled = list(present)
    random.shuffle(shuffled)
    assert transition(mode, present, sign, request_, now) == transition(
        mode, shuffled, sign, request_, now
    )


@given(modes(), some_causes, signs, requests, times)
def test_every_answer_is_at_least_what_the_gravest_cause_asks_for(
    mode, present, sign, request_, now
):
    action = gravest(present).action
    after = transition(mode, present, sign, request_, now)
    if action is Action.FAULT:
        assert after.phase is Phase.FAULT
    elif after.phase is Phase.JOG:
        assert request_ is Request.JOG and Cause.OVERRUN not in present
    elif action >= Action.HOLD:
        assert after.share == 0.0
    elif action is Action.SLOW:
        assert after.share <= 0.2
    assert after.share == 0.0 or after.phase in (Phase.ACQUIRE, Phase.SERVO, Phase.JOG)
    assert after.phase is not Phase.JOG or after.share == 0.2


@given(modes(), some_causes, signs, requests, times)
def test_servo_is_reached_from_acquire_and_from_nowhere_else(mode, present, sign, request_, now):
    if transition(mode, present, sign, request_, now).phase is Phase.SERVO:
        assert mode.phase in (Phase.ACQUIRE, Phase.SERVO)


@given(modes(), some_causes, signs, requests, times)
def test_a_person_jogs_from_idle_and_a_pause_alone_and_only_while_it_is_asked_for(
    mode, present, sign, request_, now
):
    after = transition(mode, present, sign, request_, now)
    if after.phase is Phase.JOG:
        assert request_ is Request.JOG
        assert mode.phase in (Phase.IDLE, Phase.PAUSED, Phase.JOG)
    elif mode.phase is Phase.JOG:
        assert after.phase in (Phase.PAUSED, Phase.FAULT)


@given(some_causes, some_causes, signs, requests, times)
def test_a_fault_is_left_by_clear_alone_with_its_causes_gone_and_leads_to_the_drive_off(
    first, present, sign, ask, now
):
    mode = transition(Mode(Phase.SERVO), [Cause.ARM_SILENT, *first], sign, Request.NONE, 0)
    assert mode.phase is Phase.FAULT
    after = transition(mode, present, sign, ask, now)
    if ask is Request.CLEAR and gravest(present).action < Action.FAULT:
        assert after.phase is Phase.DISABLED
    else:
        assert after == mode


@given(some_causes, signs, requests, times)
def test_a_pause_is_left_by_a_fault_or_by_a_person_into_acquire(present, sign, ask, now):
    mode = Mode(Phase.PAUSED, Cause.CAMERA_MOVED, 0, 0, Action.PAUSE)
    after = transition(mode, present, sign, ask, now)
    action = gravest(present).action
    if action is Action.FAULT:
        assert after.phase is Phase.FAULT
    elif ask is Request.RESUME and action < Action.HOLD:
        assert after.phase is Phase.ACQUIRE
    elif ask is Request.JOG and Cause.OVERRUN not in present:
        assert after.phase is Phase.JOG
    else:
        assert after.phase is Phase.PAUSED


def test_the_drive_comes_on_by_a_person_and_the_first_frames_lead_to_servo():
    mode, phases = Mode(), []
    for now in range(GOOD_TO_SERVO + 3):
        mode = transition(mode, [], GOOD, Request.NONE, now)
        phases.append(mode.phase)
    assert phases == [Phase.IDLE, *[Phase.ACQUIRE] * GOOD_TO_SERVO, Phase.SERVO, Phase.SERVO]
    off = GOOD._replace(enabled=False)
    assert transition(Mode(), [], off, Request.NONE, 0).phase is Phase.DISABLED
    unseen = GOOD._replace(seen=False)
    assert transition(Mode(Phase.IDLE), [], unseen, Request.NONE, 0).phase is Phase.IDLE


def test_ticks_without_a_new_good_frame_or_without_an_estimate_do_not_count():
    mode = Mode(Phase.ACQUIRE)
    for sign in (GOOD._replace(good=False), GOOD._replace(ready=False)):
        for now in range(3 * GOOD_TO_SERVO):
            mode = transition(mode, [], sign, Request.NONE, now)
        assert mode == Mode(Phase.ACQUIRE)


def test_a_hold_recovers_through_acquire_and_a_long_one_is_a_pause():
    held = transition(Mode(Phase.SERVO), [Cause.MARKER_1_LOST], GOOD, Request.NONE, 0)
    assert (held.phase, held.share) == (Phase.HOLD, 0.0)
    mode = held
    for now in range(GOOD_TO_RECOVER):
        assert mode.phase is Phase.HOLD
        mode = transition(mode, [], GOOD, Request.NONE, now)
    assert mode.phase is Phase.ACQUIRE
    assert (
        transition(held, [Cause.MARKER_1_LOST], GOOD, Request.NONE, HOLD_TIME).phase is Phase.HOLD
    )
    assert (
        transition(held, [Cause.MARKER_2_LOST], GOOD, Request.NONE, HOLD_TIME + 1).phase
        is Phase.PAUSED
    )


def test_a_bad_tick_starts_the_count_of_good_ones_again():
    mode = transition(Mode(Phase.SERVO), [Cause.STALE], GOOD, Request.NONE, 0)
    for now in range(1, GOOD_TO_RECOVER):
        mode = transition(mode, [], GOOD, Request.NONE, now)
    mode = transition(mode, [Cause.STALE], GOOD, Request.NONE, 9)
    assert mode.good == 0 and mode.since == 0


def test_slow_and_warn_change_the_speed_or_the_words_and_not_the_phase():
    slow = transition(Mode(Phase.SERVO), [Cause.AGEING], GOOD, Request.NONE, 0)
    warned = transition(Mode(Phase.SERVO), [Cause.LATE_TICK], GOOD, Request.NONE, 0)
    assert (slow.phase, slow.cause, slow.share) == (Phase.SERVO, Cause.AGEING, 0.2)
    assert (warned.phase, warned.cause, warned.share) == (Phase.SERVO, Cause.LATE_TICK, 1.0)


def test_a_person_may_pause_at_any_time_and_the_cause_says_so():
    mode = transition(Mode(Phase.SERVO), [], GOOD, Request.PAUSE, 0)
    assert (mode.phase, mode.cause) == (Phase.PAUSED, Cause.ASKED)


def test_a_graver_cause_that_comes_during_a_pause_is_named_instead():
    mode = Mode(Phase.PAUSED, Cause.MARKERS_LOST, 0, 0, Action.PAUSE)
    assert transition(mode, [Cause.STALE], GOOD, Request.NONE, 1).cause is Cause.MARKERS_LOST
    moved = transition(mode, [Cause.CAMERA_MOVED, Cause.TARGET_OLD], GOOD, Request.NONE, 1)
    assert moved.cause is Cause.CAMERA_MOVED
    assert transition(moved, [Cause.TARGET_OLD], GOOD, Request.NONE, 2).cause is Cause.CAMERA_MOVED
    assert transition(moved, [Cause.TARGET_OLD], GOOD, Request.RESUME, 3).cause is Cause.TARGET_OLD


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_is_a_sentence_and_whatever_stops_the_tool_has_a_way_out(cause):
    if cause is Cause.NONE:
        assert not cause.words
    else:
        assert cause.value[0].islower() and not cause.value.endswith(".")
        assert bool(cause.way_out) == (cause.action >= Action.HOLD)
    assert Cause(cause.value) is cause


def test_a_hold_that_good_frames_end_too_late_is_a_pause():
    held = Mode(Phase.HOLD, Cause.STALE, since=0, good=GOOD_TO_RECOVER - 1, asks=Action.HOLD)
    assert transition(held, [], GOOD, Request.NONE, HOLD_TIME).phase is Phase.ACQUIRE
    late = transition(held, [], GOOD, Request.NONE, HOLD_TIME + 1)
    assert late.phase is Phase.PAUSED and late.cause is Cause.STALE


@pytest.mark.parametrize("cause", Cause)
def test_only_a_cause_for_which_the_tool_stands_still_is_stopping(cause):
    after = transition(Mode(Phase.SERVO), [cause], GOOD, Request.NONE, 1)
    assert bool(cause.stopping) == (after.share == 0.0)
    assert cause.stopping in ("", cause.value)


@pytest.mark.parametrize("cause", Cause)
def test_a_fault_and_a_late_loop_end_a_jog_and_nothing_else_does(cause):
    after = transition(Mode(Phase.JOG), [cause], GOOD, Request.JOG, 1)
    if cause.action is Action.FAULT:
        assert (after.phase, after.cause) == (Phase.FAULT, cause)
    elif cause is Cause.OVERRUN:
        assert (after.phase, after.cause) == (Phase.PAUSED, cause)
    else:
        assert after == Mode(Phase.JOG, asks=Action.SLOW)
