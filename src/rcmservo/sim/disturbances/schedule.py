"""Times of the disturbances of a rig, counted from the start of the run."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rcmservo.sim.disturbances.disturbance import Disturbance


@dataclass(eq=False)
class Event:
    """Disturbance in one run.

    Parameters
    ----------
    disturbance : Disturbance
        Disturbance.
    start : int
        Start, ns.
    end : float
        End, ns; inf if it lasts to the end of the run.
    random : np.random.Generator
        Generator of its own random numbers.
    """

    disturbance: Disturbance

    start: int

    end: float

    random: np.random.Generator

    @property
    def kind(self) -> str:
        return self.disturbance.kind

    @property
    def axis(self) -> int:
        return self.disturbance.axis

    def number(self, name: str) -> float:
        """Return a parameter that is a number."""
        return self.disturbance.number(name)

    def word(self, name: str) -> str:
        """Return a parameter that is a word."""
        return str(self.disturbance.parameters[name])


class Schedule:
    """Disturbances of a rig with their times. None acts before `begin`.

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
        self._chance = seed.spawn(len(self.disturbances))
        self._seed = seed
        self.events: list[Event] = []
        self._kinds: frozenset[str] = frozenset()
        self.killed = False

    def begin(self, now: int) -> None:
        """Start the run at `now` (ns)."""
        pairs = zip(self.disturbances, self._chance, strict=True)
        self.events = [_make_event(disturbance, now, chance) for disturbance, chance in pairs]
        self._kinds = frozenset(event.kind for event in self.events)

    def add(self, disturbance: Disturbance, now: int) -> None:
        """Add a disturbance whose time counts from `now` (ns).

        Its random numbers follow from the number of disturbances before it.
        """
        self.events.append(_make_event(disturbance, now, self._seed.spawn(1)[0]))
        self._kinds |= {disturbance.kind}

    def end(self, now: int) -> None:
        """End all disturbances at `now` (ns). Permanent effects remain."""
        for event in self.events:
            event.end = min(event.end, max(event.start, now))

    def active(self, time: int, *kinds: str) -> Iterable[Event]:
        """Return the events of these kinds that act at `time` (ns)."""
        return (event for event in self.started(time, *kinds) if time < event.end)

    def started(self, time: int, *kinds: str) -> Iterable[Event]:
        """Return the events of these kinds that have started by `time` (ns), ended or not."""
        if self._kinds.isdisjoint(kinds):
            return ()
        return (event for event in self.events if event.kind in kinds and event.start <= time)


def _make_event(disturbance: Disturbance, run_start: int, chance: np.random.SeedSequence) -> Event:
    start = run_start + round(disturbance.at * 1e9)
    return Event(
        disturbance, start, start + disturbance.duration_s * 1e9, np.random.default_rng(chance)
    )
