"""Schedule of the disturbances in one run: which of them act at a time.

Times are ns of the plant's clock. Every disturbance has a random generator of its own, so that one
does not change the random numbers of another.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rcmservo.sim.disturbances.disturbance import Disturbance


class Schedule:
    """Disturbances of a laboratory with their times. None acts before `begin`.

    Parameters
    ----------
    disturbances : sequence of Disturbance
        Disturbances of the run.
    seed : numpy.random.SeedSequence
        Seed of all their random numbers.
    """

    killed: bool
    """True after the process was killed: it sends nothing more."""

    def __init__(self, disturbances: Sequence[Disturbance], seed: np.random.SeedSequence) -> None:
        self.disturbances = tuple(disturbances)
        self._event_seeds = seed.spawn(len(self.disturbances))
        self._seed = seed
        self.events: list[Event] = []
        self.killed = False

    def begin(self, now: int) -> None:
        """Start the run at `now` (ns)."""
        pairs = zip(self.disturbances, self._event_seeds, strict=True)
        self.events = [_make_event(disturbance, now, seed) for disturbance, seed in pairs]

    def add(self, disturbance: Disturbance, now: int) -> None:
        """Add a disturbance whose start counts from `now` (ns).

        Its random numbers follow from the number of disturbances before it.
        """
        self.events.append(_make_event(disturbance, now, self._seed.spawn(1)[0]))

    def end(self, now: int) -> None:
        """End all disturbances at `now` (ns). Permanent effects remain."""
        for event in self.events:
            event.end = min(event.end, max(event.start, now))

    def active(self, time: int, *kinds: str) -> list["Event"]:
        """Return the events of these kinds that act at `time` (ns).

        The arm asks four times per physics step; times are compared faster than kinds.
        """
        return [e for e in self.events if e.start <= time < e.end and e.kind in kinds]

    def started(self, time: int, *kinds: str) -> list["Event"]:
        """Return the events of these kinds that have started by `time` (ns), ended or not."""
        return [e for e in self.events if e.start <= time and e.kind in kinds]


@dataclass(eq=False)
class Event:
    """Disturbance in one run.

    Parameters
    ----------
    disturbance : Disturbance
        Kind and parameters.
    start : int
        Start, ns.
    end : float
        End, ns; inf if it lasts to the end of the run.
    random : np.random.Generator
        Generator of its random numbers.
    """

    disturbance: Disturbance

    start: int

    end: float

    random: np.random.Generator

    @property
    def kind(self) -> str:
        """Name of the disturbance's kind."""
        return self.disturbance.kind

    @property
    def axis(self) -> int:
        """Index of the joint that the disturbance concerns, from 0."""
        return self.disturbance.axis

    def number(self, name: str) -> float:
        """Return a parameter that is a number."""
        return self.disturbance.number(name)

    def word(self, name: str) -> str:
        """Return a parameter that is a word."""
        return str(self.disturbance.parameters[name])


def _make_event(disturbance: Disturbance, run_start: int, seed: np.random.SeedSequence) -> Event:
    """Return the event of a disturbance in a run that starts at `run_start` (ns)."""
    start = run_start + round(disturbance.at * 1e9)
    end = start + disturbance.duration_s * 1e9
    return Event(disturbance, start, end, np.random.default_rng(seed))
