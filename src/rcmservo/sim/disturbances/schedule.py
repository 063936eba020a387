"""Times at which the disturbances of a rig act, counted from the moment at which the run begins."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rcmservo.sim.disturbances.disturbance import Disturbance


@dataclass(eq=False)
class Event:
    """A disturbance in one run."""

    disturbance: Disturbance
    """The disturbance."""

    start: int
    """ns."""

    end: float
    """ns; inf if it acts to the end of the run."""

    random: np.random.Generator
    """Chance of its own."""

    @property
    def kind(self) -> str:
        return self.disturbance.kind

    @property
    def axis(self) -> int:
        return self.disturbance.axis

    def number(self, name: str) -> float:
        """The disturbance's parameter of this name."""
        return self.disturbance.number(name)

    def word(self, name: str) -> str:
        """The disturbance's parameter of this name, a word."""
        return str(self.disturbance.parameters[name])


class Schedule:
    """All disturbances of a rig. Nothing acts before `begin`."""

    killed: bool
    """True once the process was killed: it sends nothing any more."""

    def __init__(self, disturbances: Sequence[Disturbance], chance: np.random.SeedSequence) -> None:
        self.disturbances = tuple(disturbances)
        self._chance = chance.spawn(len(self.disturbances))
        self._later = chance
        self.events: list[Event] = []
        self._kinds: frozenset[str] = frozenset()
        self.killed = False

    def begin(self, now: int) -> None:
        """The run begins at `now` ns."""
        pairs = zip(self.disturbances, self._chance, strict=True)
        self.events = [_event(disturbance, now, chance) for disturbance, chance in pairs]
        self._kinds = frozenset(event.kind for event in self.events)

    def add(self, disturbance: Disturbance, now: int) -> None:
        """One more, whose time counts from `now` ns; its chance follows from how many there were
        before."""
        self.events.append(_event(disturbance, now, self._later.spawn(1)[0]))
        self._kinds |= {disturbance.kind}

    def end(self, now: int) -> None:
        """Whatever still acts is over at `now` ns. What stays where it is by then stays."""
        for event in self.events:
            event.end = min(event.end, max(event.start, now))

    def acting(self, time: int, *kinds: str) -> Iterable[Event]:
        """Those of these kinds that act at `time` ns."""
        return (event for event in self.begun(time, *kinds) if time < event.end)

    def begun(self, time: int, *kinds: str) -> Iterable[Event]:
        """Those of these kinds that have begun by `time` ns, whether they still act or not."""
        if self._kinds.isdisjoint(kinds):
            return ()
        return (event for event in self.events if event.kind in kinds and event.start <= time)


def _event(disturbance: Disturbance, begun: int, chance: np.random.SeedSequence) -> Event:
    start = begun + round(disturbance.at * 1e9)
    return Event(disturbance, start, start + disturbance.lasts * 1e9, np.random.default_rng(chance))
