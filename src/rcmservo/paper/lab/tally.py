"""Statistics of one method's runs, and of two methods in the same scenes with the same noise.

Intervals are of 95 %, from the statistics of studies.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.paper.plan import Found
from rcmservo.paper.statistics import finite, median, percent
from rcmservo.study.report.statistics import (
    Flags,
    Interval,
    dashed,
    median_difference,
    quantile,
    share,
    share_difference,
)
from rcmservo.study.row import NEAR
from rcmservo.study.run_outcome import StudyRun

STRIDE = 10
"""Ticks between two of the errors over time that are stored."""


def numbers_of(runs: Sequence[StudyRun]) -> Found:
    """Return the runs of one method in numbers, one for each scene.

    ``pose`` is mm of marker 2, rms over the last second; ``within`` s until it was first within 1
    mm and ``explored`` s until it was first servoed, NaN if never; ``held`` the cause that held
    the tool at the end. ``middle`` is mm over time, ``step`` s apart: the median over all runs, of
    which one that ended stays where it ended. ``length`` is s of the longest run.
    """
    longest = max(len(run.error) for run in runs)
    errors = [np.pad(run.error, (0, longest - len(run.error)), mode="edge") for run in runs]
    return {
        "seeds": [run.seed for run in runs],
        "engine": runs[0].engine,
        "pose": np.array([run.pose_error for run in runs]),
        "within": np.array([run.first_within(NEAR) for run in runs]),
        "explored": np.array([run.explored for run in runs]),
        "jacobian": np.array([run.jacobian_error for run in runs]),
        "held": [run.held.stopping for run in runs],
        "length": longest / runs[0].rate,
        "step": STRIDE / runs[0].rate,
        "middle": np.median(errors, axis=0)[::STRIDE],
    }


@dataclass(frozen=True, eq=False)
class Tally:
    """One method in all scenes of one kind.

    Parameters
    ----------
    name : str
        Name in sentences.
    short : str
        Name in figures and tables.
    runs : Found
        `numbers_of` its runs.
    never : float
        s that count as the time of a run that never was within 1 mm, the same for all methods.
    """

    name: str
    short: str
    runs: Found
    never: float

    @property
    def pose_errors(self) -> Floats:
        """Final pose errors mm (n,)."""
        return self.runs["pose"]

    @property
    def arrived(self) -> Flags:
        """Flags of the runs that ended within 1 mm."""
        return self.pose_errors <= NEAR

    @property
    def times(self) -> Floats:
        """Times s until first within 1 mm, for comparisons."""
        return np.where(np.isfinite(self.runs["within"]), self.runs["within"], self.never)

    @property
    def success(self) -> Interval:
        """Scenes that ended within 1 mm, in %."""
        return percent(share(int(self.arrived.sum()), len(self.arrived)))

    @property
    def time(self) -> Interval:
        """Median s until first within 1 mm, the exploration included; inf if never."""
        return quantile(
            np.nan_to_num(self.runs["within"], nan=np.inf, posinf=np.inf), 0.5, least=0.0
        )

    @property
    def pose(self) -> Interval:
        """Median pose error mm at the end, of all runs."""
        return quantile(self.pose_errors, 0.5, least=0.0)

    @property
    def explored(self) -> float:
        """Median s until first servoed; NaN of a method that never was."""
        return median(finite(self.runs["explored"]))

    @property
    def jacobian(self) -> float:
        """Median error of Ĵ in %; NaN where none was recorded."""
        return 100.0 * median(finite(self.runs["jacobian"]))

    @property
    def failures(self) -> str:
        """Number of runs that did not arrive, by reason."""
        distant = "more than 1 mm away with nothing wrong"
        pairs = zip(self.runs["held"], self.arrived, strict=True)
        causes, total = (
            Counter(held or distant for held, here in pairs if not here),
            len(self.arrived),
        )
        return "; ".join(f"{n} of {total} did not arrive: {why}" for why, n in causes.most_common())

    @property
    def words(self) -> str:
        """Summary in a sentence."""
        wrong = "" if np.isnan(self.jacobian) else f"; error of Ĵ {self.jacobian:.0f} %"
        return (
            f"within 1 mm after {self.time:.1f} s, servoed after "
            f"{dashed(self.explored, '.1f')} s; pose error {self.pose:.2f} mm{wrong} "
            f"(medians); worst scene {self.worst:.2f} mm"
        )

    @property
    def worst(self) -> float:
        """Largest pose error mm at the end."""
        return float(self.pose_errors.max())

    def times_as_far(self, other: "Tally") -> Interval:
        """Return the median over scenes of the ratio of both pose errors there."""
        return _ratio(self.pose_errors, other.pose_errors)

    def times_as_long(self, other: "Tally") -> Interval:
        """Return the median over scenes of the ratio of both times until within 1 mm."""
        return _ratio(self.times, other.times)

    def later(self, other: "Tally") -> Interval:
        """Return the median over scenes of the difference (s) of both times until within 1 mm."""
        return median_difference(self.times, other.times)

    def more_often(self, other: "Tally") -> Interval:
        """Return the % points of the scenes in which it arrives more often, scene by scene."""
        return percent(share_difference(self.arrived, other.arrived))


def _ratio(one: Floats, other: Floats) -> Interval:
    """Return the median over pairs of `one` / `other`."""
    return Interval(*np.exp(median_difference(np.log(one), np.log(other))).tolist())
