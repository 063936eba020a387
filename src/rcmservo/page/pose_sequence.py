"""Sequence of poses that the tool visits in turn, with a dwell at each, for a number of rounds.

go to a pose ─► errors within `SETTLED_TOLERANCE` ─► dwell ─► next pose
                               ▲                       │
                               └── errors outside it, or HOLD: the dwell restarts

A sequence ends early when the tool is stopped or paused, or gets another target.
"""

from dataclasses import dataclass
from math import ceil
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, Limit, between
from rcmservo.interfaces import Target
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import SETTLED_TOLERANCE
from rcmservo.safety.state_machine import Phase

MAX_WAYPOINTS, MAX_ROUNDS, MAX_DWELL_S = 20, 1000, 600.0
"""Largest number of waypoints, largest number of rounds, and longest dwell (s) of a sequence."""

AUTONOMOUS_PHASES = Phase.ACQUIRE, Phase.SERVO, Phase.HOLD
"""Phases in which the servo may move the tool without a further request."""


@dataclass(frozen=True)
class Waypoint(Checked):
    """Pose of a sequence and the dwell at it.

    Parameters
    ----------
    pose : str
        Name of the pose.
    dwell : float
        Time (s) for which the errors must stay within the tolerance before the tool continues.
    """

    pose: str
    dwell: Annotated[float, between(0.0, MAX_DWELL_S, "a time", "s")]


@dataclass(frozen=True)
class SequencePlan(Checked, section="sequence"):
    """Waypoints and number of rounds, as a browser requests them.

    Parameters
    ----------
    waypoints : tuple[Waypoint, ...]
        Waypoints in the order of the visits.
    rounds : int
        Number of times that all waypoints are visited.
    """

    waypoints: Annotated[
        tuple[Waypoint, ...],
        Limit(
            lambda waypoints: 1 <= len(waypoints) <= MAX_WAYPOINTS, f"1 to {MAX_WAYPOINTS} poses"
        ),
    ]
    rounds: Annotated[int, between(1, MAX_ROUNDS, "a whole number")] = 1


@dataclass(frozen=True, eq=False)
class RunSequence:
    """Request to run a pose sequence.

    Parameters
    ----------
    plan : SequencePlan
        Plan of the sequence.
    targets : tuple[Target, ...]
        Targets of the waypoints, in their order.
    """

    plan: SequencePlan
    targets: tuple[Target, ...]


@dataclass(frozen=True)
class SequenceProgress:
    """Progress of a pose sequence.

    Parameters
    ----------
    pose : str
        Name of the pose that the tool moves to or is at.
    waypoint_number : int
        Number of this waypoint, from 1.
    waypoints : int
        Number of waypoints.
    round_number : int
        Number of this round, from 1.
    rounds : int
        Number of rounds.
    remaining_s : int or None
        Remaining dwell in s, rounded up; None while the tool moves to the pose.
    """

    pose: str
    waypoint_number: int
    waypoints: int
    round_number: int
    rounds: int
    remaining_s: int | None


class SequenceRunner:
    """Pose sequence in progress. It starts at the first waypoint."""

    def __init__(self, request: RunSequence) -> None:
        self._plan, self._targets = request.plan, request.targets
        self._visit_count = 0
        """Number of completed visits."""
        self._departed_ns: int | None = None
        """Time (ns) of the first tick on the way to the present waypoint."""
        self._arrived_ns: int | None = None
        """Time (ns) since which the tool has been at the present waypoint."""
        self.progress: SequenceProgress | None = self._describe_progress(None)
        """Progress; None after the end."""
        self.outcome = ""
        """Reason of the end in words; empty before it."""

    @property
    def target(self) -> Target:
        """Target of the present waypoint."""
        return self._targets[self._visit_count % len(self._targets)]

    def update(self, tick: Tick) -> bool:
        """Process a tick, whose state holds the last target that this runner has requested.

        Returns
        -------
        bool
            True if the caller must now request `target`, the next waypoint.
        """
        now_ns, state = tick.observation.now, tick.state
        reason = find_interruption(tick, self.target)
        if reason:
            self.progress, self.outcome = None, f"the pose sequence has ended: {reason}"
            return False
        self._departed_ns = now_ns if self._departed_ns is None else self._departed_ns
        is_at_pose = bool((np.abs(state.delta) < SETTLED_TOLERANCE).all())
        is_exposed_after_departure = tick.observation.exposure >= self._departed_ns
        if state.phase is not Phase.SERVO or not is_exposed_after_departure or not is_at_pose:
            self._arrived_ns = None
        elif self._arrived_ns is None:
            self._arrived_ns = now_ns
        remaining_s = None
        if self._arrived_ns is not None:
            dwell_s = self._plan.waypoints[self._visit_count % len(self._targets)].dwell
            remaining_s = ceil(max(0.0, dwell_s - (now_ns - self._arrived_ns) * 1e-9))
        if remaining_s == 0:
            return self._advance()
        self.progress = self._describe_progress(remaining_s)
        return False

    def _describe_progress(self, remaining_s: int | None) -> SequenceProgress:
        count, rounds = len(self._targets), self._plan.rounds
        completed_rounds, index = divmod(self._visit_count, count)
        pose, round_number = self._plan.waypoints[index].pose, completed_rounds + 1
        return SequenceProgress(pose, index + 1, count, round_number, rounds, remaining_s)

    def _advance(self) -> bool:
        """Advance to the next waypoint and return True, or end the sequence and return False."""
        self._visit_count, self._departed_ns, self._arrived_ns = self._visit_count + 1, None, None
        if self._visit_count < self._plan.rounds * len(self._targets):
            self.progress = self._describe_progress(None)
            return True
        self.progress, self.outcome = None, "the pose sequence is complete"
        return False


def find_interruption(tick: Tick, target: Target) -> str:
    """Return the reason that ends a sequence on the way to a target, or ""."""
    state = tick.state
    if state.phase not in AUTONOMOUS_PHASES:
        cause = state.mode.cause.value
        return f"{state.phase.value}: {cause}" if cause else state.phase.value
    if state.target != target:
        return "the tool has another target"
    return ""
