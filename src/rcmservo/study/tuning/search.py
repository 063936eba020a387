"""Search for settings: Optuna proposes values, and a study evaluates them.

Every trial is a study of the same scenes with the same noise, so that trials differ in their
settings alone. Its chunks of runs are stored like those of any study: a stopped search repeats the
same trials without running anything twice. The result is then compared with the initial settings on
scenes outside the search, because the best of many trials looks better than it is on the scenes
that selected it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from rcmservo.constraints import Checked, between, one_of
from rcmservo.errors import require, require_extra
from rcmservo.interfaces import Floats
from rcmservo.servo.user_estimator import UnusableEstimator
from rcmservo.study.execution.run_study import StudyExecution
from rcmservo.study.execution.workers import WorkerPool
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.tuning.space import SearchAxis, Values, get_setting, replace_settings

with require_extra("a study", "study"):
    import optuna

OPTUNA: Any = optuna
TUNE_GOALS = "time", "error"
"""Quantities that a search minimises."""
FAILED_RUN_COST_MM = 10.0
"""Cost of a failed run if the goal is the error, mm."""
MAX_REPORTED_COST = 1e6
"""Cost that Optuna gets in place of an infinite one, which it does not accept."""
TUNED_METHOD, RETUNED_METHOD = "tuned", "tuned-again"
"""Names of the resulting method; the second one if the search starts from the first."""


@dataclass(frozen=True, kw_only=True)
class TuneSection(Checked, section="tune"):
    """Section [tune] of a study file: length and goal of a search.

    Parameters
    ----------
    trials : int
        Number of trials.
    goal : str
        Mean over the runs that the search minimises. `time`: s until first within 1 mm, twice the
        length of the run for a failed one. `error`: pose error in mm, at most 10 mm, which is also
        the value for a failed run.
    seed : int
        Seed of the optimiser.
    validation : int
        Number of scenes outside the search that the result is compared on.
    """

    trials: Annotated[int, between(1, 100_000, "a whole number")] = 50
    goal: Annotated[str, one_of(TUNE_GOALS)] = "time"
    seed: Annotated[int, between(0, 2**32 - 1, "a whole number")] = 0
    validation: Annotated[int, between(10, 1_000_000, "a whole number")] = 1000


@dataclass(frozen=True, kw_only=True)
class Tuning(TuneSection):
    """Search: its initial method, its scenes, and the settings to vary.

    Parameters
    ----------
    plan : StudyPlan
        Plan with one method, the initial one, and the scenes of the search.
    axes : tuple[SearchAxis, ...]
        Settings to vary, with their ranges.
    """

    plan: StudyPlan
    axes: tuple[SearchAxis, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        require(bool(self.axes), "search", "nothing", "at least one setting")
        require(len(self.plan.methods) == 1, "method", len(self.plan.methods), "exactly one")

    @property
    def method_name(self) -> str:
        """Name of the resulting method."""
        return RETUNED_METHOD if self.plan.methods[0].name == TUNED_METHOD else TUNED_METHOD

    @property
    def validation_plan(self) -> StudyPlan:
        """Plan of the validation, with the initial method."""
        first = self.plan.first_seed + self.plan.count
        return replace(self.plan, first_seed=first, count=self.validation)


class SearchTrial(NamedTuple):
    """Trial of a search.

    Parameters
    ----------
    number : int
        Number of the trial, from 0.
    values : Mapping[str, Any]
        Values of the varied settings.
    cost : float
        Value of the goal; inf for an invalid combination of settings.
    success : float
        Success rate.
    """

    number: int
    values: Values
    cost: float
    success: float


def run_search(
    tuning: Tuning, folder: Path, pool: WorkerPool, report_trial: Callable[[SearchTrial], None]
) -> list[SearchTrial]:
    """Run all trials of a search, with their chunks stored in the folder.

    The first trial has the initial settings.
    """
    OPTUNA.logging.set_verbosity(OPTUNA.logging.ERROR)
    sampler = OPTUNA.samplers.TPESampler(seed=tuning.seed)
    study = OPTUNA.create_study(sampler=sampler, direction="minimize")
    initial = {axis.name: get_setting(tuning.plan.methods[0], axis.name) for axis in tuning.axes}
    is_within_ranges = all(axis.contains(initial[axis.name]) for axis in tuning.axes)
    if is_within_ranges:
        study.enqueue_trial(initial)
    trials: list[SearchTrial] = []
    for number in range(tuning.trials):
        # Optuna accepts no trial outside the ranges: it gets no result of initial settings there
        proposal = study.ask() if number or is_within_ranges else None
        values = initial if proposal is None else {a.name: a.suggest(proposal) for a in tuning.axes}
        trial = _run_trial(tuning, number, values, folder, pool)
        if proposal is not None:
            study.tell(proposal, min(trial.cost, MAX_REPORTED_COST))
        report_trial(trial)
        trials.append(trial)
    return trials


def _run_trial(
    tuning: Tuning, number: int, values: Values, folder: Path, pool: WorkerPool
) -> SearchTrial:
    """Run the study of one trial; an invalid combination of settings costs inf."""
    try:
        method = replace_settings(tuning.plan.methods[0], tuning.method_name, values)
        execution = StudyExecution(replace(tuning.plan, methods=(method,)), folder)
    except (ValueError, UnusableEstimator):  # invalid combination of settings
        return SearchTrial(number, values, np.inf, 0.0)
    execution.run(pool, lambda _: None)
    rows = execution.gather()
    success: Any = rows["success"].to_numpy()
    return SearchTrial(number, values, compute_cost(tuning, rows), float(success.mean()))


def compute_cost(tuning: Tuning, rows: Any) -> float:
    """Return the mean of the goal over the runs: s or mm."""
    success: Any = rows["success"].to_numpy()
    column, failed_cost = "pose_error_mm", FAILED_RUN_COST_MM
    if tuning.goal == "time":
        column, failed_cost = "time_to_1mm_s", 2.0 * tuning.plan.duration
    costs: Floats = rows[column].to_numpy().astype(np.float64)
    return float(np.mean(np.where(success, np.minimum(costs, failed_cost), failed_cost)))


def find_best_trial(trials: list[SearchTrial]) -> SearchTrial:
    """Return the trial with the smallest cost, the first of equal ones."""
    return min(trials, key=lambda trial: (trial.cost, trial.number))
