"""Table of causes: order of severity, detectors and what each cause invalidates."""

from itertools import pairwise

import pytest

from conftest import make_tick_facts
from rcmservo.numerics.structs import replace_fields, to_row
from rcmservo.safety.causes import (
    CAUSES,
    Action,
    Cause,
    Invalidates,
    find_invalidated,
    select_more_severe,
    select_most_severe,
)
from rcmservo.safety.monitor_state import initial_monitor_state
from rcmservo.safety.thresholds import Thresholds

WITHOUT_DETECTOR = Cause.NONE, Cause.NOT_FINITE, Cause.ASKED
"""Causes that the gate or the state machine raises."""


def test_causes_are_ordered_by_severity() -> None:
    assert all(one.action >= other.action for one, other in pairwise(CAUSES[1:]))


def test_every_cause_has_its_own_detector() -> None:
    detectors = [cause.declared.detector for cause in Cause if cause not in WITHOUT_DETECTOR]
    assert None not in detectors and len(set(detectors)) == len(detectors)
    assert [cause for cause in WITHOUT_DETECTOR if cause.declared.detector] == []


def test_the_help_of_the_enumeration_explains_every_cause() -> None:
    text = " ".join((Cause.__doc__ or "").split())
    assert all(f"{cause.name} {cause.action.name}: {cause.text}." in text for cause in CAUSES[1:])


@pytest.mark.parametrize("cause", CAUSES[1:])
def test_the_most_severe_of_several_causes_is_reported(cause: Cause) -> None:
    assert select_most_severe(cause.bit | Cause.LATE_TICK.bit) == cause.code
    assert select_more_severe(cause.code, 0) == select_more_severe(0, cause.code) == cause.code
    assert select_more_severe(cause.code, Cause.NOT_FINITE.code) == Cause.NOT_FINITE.code


@pytest.mark.parametrize(
    ("cause", "explored", "unexplored"),
    [
        (Cause.DRIFTS, Invalidates.ESTIMATE_AND_TARGETS, Invalidates.ESTIMATE_AND_TARGETS),
        (Cause.DIVERGED, Invalidates.ESTIMATE, Invalidates.ESTIMATE),
        (Cause.SURPRISED, Invalidates.NOTHING, Invalidates.ESTIMATE_AND_TARGETS),
        (Cause.SWAPPED, Invalidates.NOTHING, Invalidates.ESTIMATE),
        (Cause.STALLED, Invalidates.NOTHING, Invalidates.NOTHING),
    ],
)
def test_some_causes_leave_the_estimate_valid(
    cause: Cause, explored: Invalidates, unexplored: Invalidates
) -> None:
    assert find_invalidated(cause.code, True) == explored
    assert find_invalidated(cause.code, False) == unexplored


def test_a_detector_needs_only_its_own_facts() -> None:
    late_ticks = Thresholds.max_late_ticks
    monitor = replace_fields(initial_monitor_state(), late_ticks=late_ticks, tick_interval=1)
    facts = make_tick_facts(monitor=monitor, period=1, thresholds=to_row(Thresholds())[0])
    detected_causes = [
        cause
        for cause in (Cause.OVERRUN, Cause.LATE_TICK, Cause.CLOCK_STOOD)
        if cause.declared.detector and cause.declared.detector(facts)
    ]
    assert detected_causes == [Cause.OVERRUN, Cause.LATE_TICK]
    assert select_most_severe(Cause.OVERRUN.bit | Cause.LATE_TICK.bit) == Cause.OVERRUN.code
    assert Cause.OVERRUN.action is Action.PAUSE
