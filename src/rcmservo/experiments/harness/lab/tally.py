"""What the runs of one method come to, and how two methods stand to each other in the same scenes
with the same noise. Intervals are of 95 %, and come of the statistics of studies."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rcmservo.experiments.harness.lab.attempt import Conditions, Fared
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.statistics import median, percent, spread, told
from rcmservo.interfaces import Floats
from rcmservo.study.row import NEAR
from rcmservo.study.told.statistics import (
    Flags,
    Interval,
    median_difference,
    quantile,
    share,
    share_difference,
)

Scenes = Literal["accepted", "rejected"]
SCENES: tuple[Scenes, ...] = ("accepted", "rejected")
"""By our own condition on scenes."""

AS_NEAR = 1.25
"""Ratio of pose errors up to which two methods end equally near."""

STEP = 10
"""Ticks between two of the errors over time that are kept."""


@dataclass(frozen=True, eq=False)
class MethodRuns:
    """The runs of one method, a number for each scene."""

    seeds: list[int]
    """Of the scenes."""
    engine: str
    """What made them: the compiled twin, or MuJoCo with the live path's code."""
    pose: JsonFloats
    """mm of marker 2, root mean square over the last second."""
    within: JsonFloats
    """s until marker 2 was first within 1 mm; NaN if never."""
    explored: JsonFloats
    """s until it was first servoed; NaN if never."""
    jacobian: JsonFloats
    """Median scaled error of Ĵ; NaN where it was not looked at."""
    held: list[str]
    """What it stood still for at the end, in words; empty where it did not."""
    length: float
    """s of the longest run."""
    step: float
    """s between two of the ``middle``."""
    middle: JsonFloats
    """mm of marker 2 over time, the median over all runs; one that ended stays where it ended."""


def runs_of(fared: Sequence[Fared]) -> MethodRuns:
    """The runs of one method in numbers."""
    runs = [one.run for one in fared]
    longest = max(len(run.error) for run in runs)
    errors = [np.pad(run.error, (0, longest - len(run.error)), mode="edge") for run in runs]
    return MethodRuns(
        seeds=[run.seed for run in runs],
        engine=fared[0].engine,
        pose=np.array([run.pose_error for run in runs]),
        within=np.array([_known(run.first_within(NEAR)) for run in runs]),
        explored=np.array([_known(run.explored) for run in runs]),
        jacobian=np.array([one.jacobian for one in fared]),
        held=[run.held.stopping for run in runs],
        length=longest / runs[0].rate,
        step=STEP / runs[0].rate,
        middle=np.median(errors, axis=0)[::STEP],
    )


def _known(time: float) -> float:
    return time if np.isfinite(time) else np.nan


@dataclass(frozen=True)
class Tally:
    """One method in all scenes of one kind."""

    name: str
    """In sentences."""
    short: str
    """In figures and tables."""
    runs: MethodRuns
    """One for each scene."""
    never: float
    """s that count as the time of a run that never was within 1 mm, the same for all methods."""

    @property
    def arrived(self) -> Flags:
        """Which runs ended within 1 mm."""
        return self.runs.pose <= NEAR

    @property
    def times(self) -> Floats:
        """s until first within 1 mm, for comparisons."""
        return np.where(np.isnan(self.runs.within), self.never, self.runs.within)

    @property
    def success(self) -> Interval:
        """% of the scenes that ended within 1 mm."""
        return percent(share(int(self.arrived.sum()), len(self.arrived)))

    @property
    def time(self) -> Interval:
        """Median s until first within 1 mm, the exploration included; inf if never."""
        return quantile(np.nan_to_num(self.runs.within, nan=np.inf), 0.5, least=0.0)

    @property
    def pose(self) -> Interval:
        """Median pose error mm at the end, of all runs."""
        return quantile(self.runs.pose, 0.5, least=0.0)

    @property
    def worst(self) -> float:
        """Largest pose error mm at the end."""
        return float(self.runs.pose.max())

    @property
    def explored(self) -> float:
        """Median s until first servoed; NaN of a method that never was."""
        return median(self.runs.explored[np.isfinite(self.runs.explored)])

    @property
    def jacobian(self) -> float:
        """Median scaled error of Ĵ; NaN where none was looked at."""
        return median(self.runs.jacobian[np.isfinite(self.runs.jacobian)])

    @property
    def failures(self) -> str:
        """How many did not arrive, and why."""
        away = "more than 1 mm away with nothing wrong"
        causes = Counter(
            held or away
            for held, arrived in zip(self.runs.held, self.arrived, strict=True)
            if not arrived
        )
        total = len(self.arrived)
        return "; ".join(f"{n} of {total} did not arrive: {why}" for why, n in causes.most_common())

    @property
    def words(self) -> str:
        wrong = "" if np.isnan(self.jacobian) else f"; error of Ĵ {100.0 * self.jacobian:.0f} %"
        return (
            f"within 1 mm after {spread(self.time, '.1f')} s, servoed after "
            f"{told(self.explored, '.1f')} s; pose error {spread(self.pose)} mm{wrong} (medians); "
            f"worst scene {self.worst:.2f} mm"
        )

    def times_as_far(self, other: "Tally") -> Interval:
        """How many times as far from the target's pose it ends as another: the median over scenes
        of the ratio of both pose errors there."""
        return _ratio(self.runs.pose, other.runs.pose)

    def times_as_long(self, other: "Tally") -> Interval:
        """How many times as long as another it takes to be within 1 mm: the median over scenes."""
        return _ratio(self.times, other.times)

    def later(self, other: "Tally") -> Interval:
        """s by which it is within 1 mm later than another: the median over scenes."""
        return median_difference(self.times, other.times)

    def oftener(self, other: "Tally") -> Interval:
        """% points of the scenes that it arrives in more than another, in the same scenes."""
        return percent(share_difference(self.arrived, other.arrived))


def _ratio(one: Floats, other: Floats) -> Interval:
    """The median over pairs of `one` / `other`."""
    return Interval(*np.exp(median_difference(np.log(one), np.log(other))).tolist())


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
            f"{accepted.short} {spread(accepted.pose)} mm, in scenes that our condition rejects "
            f"{spread(rejected.pose)} mm"
        )
