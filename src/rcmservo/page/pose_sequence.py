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

STOPS, ROUNDS, LONGEST = 20, 1000, 600.0
"""The most of them, and the longest dwell, s."""

BY_ITSELF = Phase.ACQUIRE, Phase.SERVO, Phase.HOLD
"""Phases in which the tool goes its own way."""


@dataclass(frozen=True)
class Stay(Checked):
    """A pose of a tour.

    Parameters
    ----------
    pose : str
        Its name.
    dwell : float
        s for which the errors stay small before the tool goes on.
    """

    pose: str
    dwell: Annotated[float, between(0.0, LONGEST, "a time", "s")]


@dataclass(frozen=True)
class Plan(Checked, section="tour"):
    """What a person asks for.

    Parameters
    ----------
    stops : tuple[Stay, ...]
        In the order of the visits.
    rounds : int
        How often all are visited.
    """

    stops: Annotated[
        tuple[Stay, ...], Limit(lambda stops: 1 <= len(stops) <= STOPS, f"1 to {STOPS} poses")
    ]
    rounds: Annotated[int, between(1, ROUNDS, "a whole number")] = 1


@dataclass(frozen=True, eq=False)
class GoOnTour:
    """Wanted: that the tool goes on a tour.

    Parameters
    ----------
    plan : Plan
        Where to, and for how long.
    targets : tuple[Target, ...]
        Those of its stops.
    """

    plan: Plan
    targets: tuple[Target, ...]


@dataclass(frozen=True)
class HowFar:
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
    stop: int
    stops: int
    lap: int
    laps: int
    left: int | None


class Touring:
    """A tour under way. It begins by going to the first stop."""

    def __init__(self, tour: GoOnTour) -> None:
        self._plan, self._targets = tour.plan, tour.targets
        self._visits = 0
        self._aimed: int | None = None
        self._there: int | None = None
        self.progress: HowFar | None = self._told(None)
        """None once the tour is over."""
        self.words = ""
        """How it ended; empty before."""

    @property
    def target(self) -> Target:
        """That of the stop it goes to or is at."""
        return self._targets[self._visits % len(self._targets)]

    def look(self, tick: Tick) -> bool:
        """Take a tick that goes by what was wanted; whether to go to another stop from now on."""
        now, state = tick.seen.now, tick.state
        why = stopped(tick, self.target)
        if why:
            self.progress, self.words = None, f"the tour has ended: {why}"
            return False
        self._aimed = now if self._aimed is None else self._aimed
        small = bool((np.abs(state.delta) < TOLERANCE).all())
        if state.phase is not Phase.SERVO or tick.seen.exposure < self._aimed or not small:
            self._there = None
        elif self._there is None:
            self._there = now
        left = None if self._there is None else self._left(now - self._there)
        if left == 0:
            return self._goes_on()
        self.progress = self._told(left)
        return False

    def _left(self, stayed: int) -> int:
        stop = self._plan.stops[self._visits % len(self._targets)]
        return ceil(max(0.0, stop.dwell - stayed * 1e-9))

    def _told(self, left: int | None) -> HowFar:
        stops, laps = len(self._targets), self._plan.rounds
        lap, stop = divmod(self._visits, stops)
        return HowFar(self._plan.stops[stop].pose, stop + 1, stops, lap + 1, laps, left)

    def _goes_on(self) -> bool:
        """To the next stop, or to the end."""
        self._visits, self._aimed, self._there = self._visits + 1, None, None
        if self._visits < self._plan.rounds * len(self._targets):
            self.progress = self._told(None)
            return True
        self.progress, self.words = None, "the tour is over: all its poses were visited"
        return False


def stopped(tick: Tick, target: Target) -> str:
    """What ends a tour to a target; empty where nothing does."""
    state = tick.state
    if state.phase not in BY_ITSELF:
        cause = state.mode.cause.value
        return f"{state.phase.value}: {cause}" if cause else state.phase.value
    if state.target is None or not same(state.target, target):
        return "the tool was sent elsewhere"
    return ""
