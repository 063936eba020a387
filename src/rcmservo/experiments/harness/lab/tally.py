"""What many trials of one method come to, and those of all methods in both kinds of scenes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from rcmservo.experiments.harness.lab.methods import Conditions
from rcmservo.experiments.harness.lab.witness import Trial
from rcmservo.experiments.harness.statistics import known, median, share, told

Scenes = Literal["accepted", "rejected"]
SCENES: tuple[Scenes, ...] = ("accepted", "rejected")
"""By our own condition on scenes."""


@dataclass(frozen=True)
class Tally:
    """One method in all scenes of one kind."""

    name: str
    """In sentences."""
    short: str
    """In figures and tables."""
    trials: Sequence[Trial]
    """One for each scene."""
    longest: float
    """s that count as the time of a run that never settled."""

    @property
    def settled(self) -> float:
        """% of the scenes."""
        return 100.0 * share(trial.settled for trial in self.trials)

    @property
    def time(self) -> float:
        """Median s until settled, the exploration included."""
        times = [trial.settle_time for trial in self.trials]
        return median([self.longest if time is None else time for time in times])

    @property
    def explored(self) -> float:
        """Median s of exploration; 0 of a method that needs none."""
        return median([trial.explored_at or 0.0 for trial in self.trials])

    @property
    def pose(self) -> float:
        """Median pose error mm at the end."""
        return median([trial.pose for trial in self.trials])

    @property
    def worst(self) -> float:
        """Largest pose error mm at the end."""
        return max(trial.pose for trial in self.trials)

    @property
    def jacobian(self) -> float:
        """Median scaled error of Ĵ; NaN where the method has none."""
        return median(known(trial.jacobian for trial in self.trials))

    @property
    def failures(self) -> str:
        """How many did not settle, and why."""
        causes = Counter(trial.why_not for trial in self.trials if not trial.settled)
        total = len(self.trials)
        return "; ".join(f"{n} of {total} not settled: {cause}" for cause, n in causes.items())

    @property
    def words(self) -> str:
        settled = f"settled after {self.time:.1f} s" if self.settled else "never settled"
        return (
            f"{settled}, explored for {self.explored:.1f} s; pose error {self.pose:.2f} mm, worst "
            f"scene {self.worst:.2f} mm; error of Ĵ {told(100.0 * self.jacobian, '.0f')} % "
            "(medians but for the worst)"
        )


@dataclass(frozen=True)
class Tallies:
    """All methods in both kinds of scenes."""

    accepted: dict[str, Tally]
    """By the methods' names, in the scenes that our condition accepts."""
    rejected: dict[str, Tally]
    """By the methods' names, in the scenes that it rejects."""
    seeds: Sequence[int]
    """Of the accepted scenes, which the claims are about."""
    conditions: Conditions
    """Under which every method ran."""

    @property
    def short(self) -> list[str]:
        """The methods as figures call them."""
        return [tally.short for tally in self.accepted.values()]

    def of(self, scenes: Scenes) -> dict[str, Tally]:
        return self.accepted if scenes == "accepted" else self.rejected

    def apart(self, name: str) -> str:
        """In words, how one method ends in either kind of scenes."""
        accepted, rejected = self.accepted[name], self.rejected[name]
        return (
            f"{accepted.short} {accepted.pose:.2f} mm (in scenes that our condition rejects "
            f"{rejected.pose:.2f} mm)"
        )
