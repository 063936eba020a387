"""A tour: poses that are visited in turn, each for a while, round after round.

go to a pose ─► errors within the verdict's tolerance ─► for the whole dwell ─► the next pose
                        ▲ outside, or held still: the dwell begins anew │

What stops the tool, or sends it elsewhere, ends the tour.
"""

from dataclasses import dataclass
from math import ceil
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, Limit, between
from rcmservo.interfaces import Target
from rcmservo.loop.operator import same
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import TOLERANCE
from rcmservo.safety.state_machine import Phase

MAX_WAYPOINTS, MAX_ROUNDS, MAX_DWELL_S = 20, 1000, 600.0
"""The most of them, and the longest dwell, s."""

AUTONOMOUS_PHASES = Phase.ACQUIRE, Phase.SERVO, Phase.HOLD
"""Phases in which the tool goes its own way."""


@dataclass(frozen=True)
class Waypoint(Checked):
    """A pose of a tour.

    Parameters
    ----------
    pose : str
        Its name.
    dwell : float
        s for which the errors stay small before the tool goes on.
    """

    pose: str
    dwell: Annotated[float, between(0.0, MAX_DWELL_S, "a time", "s")]


@dataclass(frozen=True)
class SequencePlan(Checked, section="tour"):
    """What a person asks for.

    Parameters
    ----------
    stops : tuple[Stay, ...]
        In the order of the visits.
    rounds : int
        How often all are visited.
    """

    waypoints: Annotated[
        tuple[Waypoint, ...],
        Limit(lambda stops: 1 <= len(stops) <= MAX_WAYPOINTS, f"1 to {MAX_WAYPOINTS} poses"),
    ]
    rounds: Annotated[int, between(1, MAX_ROUNDS, "a whole number")] = 1


@dataclass(frozen=True, eq=False)
class RunSequence:
    """Wanted: that the tool goes on a tour.

    Parameters
    ----------
    plan : Plan
        Where to, and for how long.
    targets : tuple[Target, ...]
        Those of its stops.
    """

    plan: SequencePlan
    targets: tuple[Target, ...]


@dataclass(frozen=True)
class SequenceProgress:
    """How far a tour is.

    Parameters
    ----------
    pose : str
        The one that the tool goes to or is at.
    stop : int
        Which of the stops that is, from 1,
    stops : int
        of how many.
    lap : int
        Which round, from 1,
    laps : int
        of how many.
    left : int or None
        s of the dwell that are left, rounded up; None on the way there.
    """

    pose: str
    waypoint_number: int
    waypoints: int
    round_number: int
    rounds: int
    remaining_s: int | None


class SequenceRunner:
    """A tour under way. It begins by going to the first stop."""

    def __init__(self, request: RunSequence) -> None:
        self._plan, self._targets = request.plan, request.targets
        self._visit_count = 0
        self._requested_at: int | None = None
        self._arrived_at: int | None = None
        self.progress: SequenceProgress | None = self._progress_at(None)
        """None once the tour is over."""
        self.outcome = ""
        """How it ended; empty before."""

    @property
    def target(self) -> Target:
        """That of the stop it goes to or is at."""
        return self._targets[self._visit_count % len(self._targets)]

    def update(self, tick: Tick) -> bool:
        """Take a tick that goes by what was wanted; whether to go to another stop from now on."""
        now, state = tick.seen.now, tick.state
        reason = interruption(tick, self.target)
        if reason:
            self.progress, self.outcome = None, f"the tour has ended: {reason}"
            return False
        self._requested_at = now if self._requested_at is None else self._requested_at
        is_at_pose = bool((np.abs(state.delta) < TOLERANCE).all())
        if (
            state.phase is not Phase.SERVO
            or tick.seen.exposure < self._requested_at
            or not is_at_pose
        ):
            self._arrived_at = None
        elif self._arrived_at is None:
            self._arrived_at = now
        remaining_s = (
            None if self._arrived_at is None else self._remaining_dwell(now - self._arrived_at)
        )
        if remaining_s == 0:
            return self._advance()
        self.progress = self._progress_at(remaining_s)
        return False

    def _remaining_dwell(self, elapsed_ns: int) -> int:
        waypoint = self._plan.waypoints[self._visit_count % len(self._targets)]
        return ceil(max(0.0, waypoint.dwell - elapsed_ns * 1e-9))

    def _progress_at(self, remaining_s: int | None) -> SequenceProgress:
        count, rounds = len(self._targets), self._plan.rounds
        completed, index = divmod(self._visit_count, count)
        return SequenceProgress(
            self._plan.waypoints[index].pose, index + 1, count, completed + 1, rounds, remaining_s
        )

    def _advance(self) -> bool:
        """To the next stop, or to the end."""
        self._visit_count, self._requested_at, self._arrived_at = self._visit_count + 1, None, None
        if self._visit_count < self._plan.rounds * len(self._targets):
            self.progress = self._progress_at(None)
            return True
        self.progress, self.outcome = None, "the tour is over: all its poses were visited"
        return False


def interruption(tick: Tick, target: Target) -> str:
    """What ends a tour to a target; empty where nothing does."""
    state = tick.state
    if state.phase not in AUTONOMOUS_PHASES:
        cause = state.mode.cause.value
        return f"{state.phase.value}: {cause}" if cause else state.phase.value
    if state.target is None or not same(state.target, target):
        return "the tool was sent elsewhere"
    return ""
