"""Statistics of the runs of one method, and of two methods in the same scenes with the same noise.

Confidence intervals are of 95 %; `study/report` computes them.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.paper.plan import TaskResult
from rcmservo.paper.statistics import finite, median, to_percent
from rcmservo.study.report.statistics import (
    Booleans,
    Interval,
    estimate_fraction,
    estimate_fraction_difference,
    estimate_median_difference,
    estimate_quantile,
    format_finite,
)
from rcmservo.study.row import SUCCESS_MM
from rcmservo.study.run_outcome import StudyRun

STORED_STRIDE = 10
"""Ticks between two stored errors over time."""


def summarise_runs(runs: Sequence[StudyRun]) -> TaskResult:
    """Return the results of the runs of one method, one entry per scene.

    ``pose`` is the error (mm) of marker 2, rms over the last second; ``within`` the time (s) until
    it is first within 1 mm and ``explored`` the time (s) until the servo starts, NaN if never;
    ``held`` the cause that stops the tool at the end. ``middle`` is the median error (mm) over all
    runs at times ``step`` (s) apart; a run that ended keeps its last error. ``length`` is the
    duration (s) of the longest run.
    """
    rate, longest = runs[0].rate, max(len(run.error) for run in runs)
    errors = [np.pad(run.error, (0, longest - len(run.error)), mode="edge") for run in runs]
    return {
        "seeds": [run.seed for run in runs],
        "engine": runs[0].engine,
        "pose": np.array([run.pose_error for run in runs]),
        "within": np.array([run.first_within(SUCCESS_MM) for run in runs]),
        "explored": np.array([run.explored for run in runs]),
        "jacobian": np.array([run.jacobian_error for run in runs]),
        "held": [run.held.stop_sentence for run in runs],
        "length": longest / rate,
        "step": STORED_STRIDE / rate,
        "middle": np.median(errors, axis=0)[::STORED_STRIDE],
    }


@dataclass(frozen=True, eq=False)
class MethodStatistics:
    """Statistics of one method in all scenes of one kind.

    Parameters
    ----------
    name : str
        Name in sentences.
    short : str
        Short name in figures and tables.
    runs : TaskResult
        Results of the runs, from `summarise_runs`.
    never : float
        Time (s) that counts for a run that never comes within 1 mm, the same for all methods.
    """

    name: str
    short: str
    runs: TaskResult
    never: float

    @property
    def pose_errors(self) -> Floats:
        """Final pose errors (n,) in mm."""
        return self.runs["pose"]

    @property
    def arrived(self) -> Booleans:
        """Flags (n,) of the runs that end within 1 mm."""
        return self.pose_errors <= SUCCESS_MM

    @property
    def times(self) -> Floats:
        """Times (n,) in s until first within 1 mm; `never` for other runs."""
        return np.where(np.isfinite(self.runs["within"]), self.runs["within"], self.never)

    @property
    def success(self) -> Interval:
        """Percentage of the scenes that end within 1 mm."""
        return to_percent(estimate_fraction(int(self.arrived.sum()), len(self.arrived)))

    @property
    def time(self) -> Interval:
        """Median time (s) until first within 1 mm, including the exploration; inf if never."""
        times = np.nan_to_num(self.runs["within"], nan=np.inf, posinf=np.inf)
        return estimate_quantile(times, 0.5, lower_bound=0.0)

    @property
    def pose(self) -> Interval:
        """Median final pose error (mm) of all runs."""
        return estimate_quantile(self.pose_errors, 0.5, lower_bound=0.0)

    @property
    def explored(self) -> float:
        """Median time (s) until the servo starts; NaN for a method that never servoed."""
        return median(finite(self.runs["explored"]))

    @property
    def jacobian(self) -> float:
        """Median error of Ĵ in %; NaN if none was recorded."""
        return 100.0 * median(finite(self.runs["jacobian"]))

    @property
    def failures(self) -> str:
        """Numbers of runs that did not arrive, by cause, as text."""
        pairs, count = zip(self.runs["held"], self.arrived, strict=True), len(self.arrived)
        causes = [
            held or "error above 1 mm without a stop" for held, arrived in pairs if not arrived
        ]
        frequent = Counter(causes).most_common()
        return "; ".join(f"{n} of {count} did not arrive: {cause}" for cause, n in frequent)

    @property
    def summary(self) -> str:
        """Summary as text."""
        jacobian = "" if np.isnan(self.jacobian) else f"; error of Ĵ {self.jacobian:.0f} %"
        return (
            f"within 1 mm after {self.time:.1f} s, servo started after "
            f"{format_finite(self.explored, '.1f')} s; pose error {self.pose:.2f} mm{jacobian} "
            f"(medians); worst scene {self.worst:.2f} mm"
        )

    @property
    def worst(self) -> float:
        """Largest final pose error (mm)."""
        return float(self.pose_errors.max())

    def times_as_far(self, other: "MethodStatistics") -> Interval:
        """Return the median over scenes of the ratio of both final pose errors."""
        return _estimate_ratio(self.pose_errors, other.pose_errors)

    def times_as_long(self, other: "MethodStatistics") -> Interval:
        """Return the median over scenes of the ratio of both `times`."""
        return _estimate_ratio(self.times, other.times)

    def later(self, other: "MethodStatistics") -> Interval:
        """Return the median over scenes of the difference (s) of both `times`."""
        return estimate_median_difference(self.times, other.times)

    def more_often(self, other: "MethodStatistics") -> Interval:
        """Return the difference of both success rates in percentage points, paired by scene."""
        return to_percent(estimate_fraction_difference(self.arrived, other.arrived))


def _estimate_ratio(values: Floats, others: Floats) -> Interval:
    """Return the median over pairs of the ratio `values` / `others`."""
    difference = estimate_median_difference(np.log(values), np.log(others))
    return Interval(*np.exp(difference).tolist())
