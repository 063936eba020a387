"""The search: Optuna asks, a study answers.

Every trial is a study of the same scenes with the same noise, so that two trials differ by their
settings alone, and what is done of it is kept like that of any study: a search that was stopped
goes the same way again, without doing anything twice. What it found is then held against the
settings at the start, in scenes that the search has not seen: the best of many trials looks better
than it is on the scenes that it was chosen by.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from rcmservo.constraints import Checked, between, one_of
from rcmservo.errors import needing, require
from rcmservo.interfaces import Floats
from rcmservo.servo.user_estimator import UnusableEstimator
from rcmservo.study.execution.run_study import Work
from rcmservo.study.execution.workers import Crew
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.tuning.space import SearchAxis, Values, value_of, with_values

with needing("a study", "study"):
    import optuna

OPTUNA: Any = optuna
GOALS = "time", "error"
FAILED_MM = 10.0
"""What a run that fails counts as where the goal is the error, mm."""
TUNED, AGAIN = "tuned", "tuned-again"
"""What is found is called; and where the search starts at what one before has found."""


@dataclass(frozen=True, kw_only=True)
class TuneSection(Checked, section="tune"):
    """[tune] of a study's file: length and goal of a search.

    Parameters
    ----------
    trials : int
        Settings that are tried.
    goal : str
        What is to be small, on an average over the runs: `time`, s until first within 1 mm, a run
        that fails counting as twice its length; or `error`, mm off at the end, a run that fails
        counting as FAILED_MM.
    seed : int
        Of the optimiser's chance.
    validation : int
        Scenes that the search has not seen, on which it is tried.
    """

    trials: Annotated[int, between(1, 100_000, "a whole number")] = 50
    goal: Annotated[str, one_of(GOALS)] = "time"
    seed: Annotated[int, between(0, 2**32 - 1, "a whole number")] = 0
    validation: Annotated[int, between(10, 1_000_000, "a whole number")] = 1000


@dataclass(frozen=True, kw_only=True)
class Tuning(TuneSection):
    """Settings that are searched, and the length and goal of the search.

    Parameters
    ----------
    plan : StudyPlan
        Its one method is where the search starts; its scenes are those of the search.
    axes : tuple[SearchAxis, ...]
        What is searched.
    """

    plan: StudyPlan
    axes: tuple[SearchAxis, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        require(bool(self.axes), "search", "nothing", "a setting at least")
        require(len(self.plan.methods) == 1, "method", len(self.plan.methods), "one that is tuned")

    @property
    def name(self) -> str:
        """Of what is found."""
        return AGAIN if self.plan.methods[0].name == TUNED else TUNED

    @property
    def unseen(self) -> StudyPlan:
        """The plan of the validation, without what was found yet."""
        first = self.plan.first_seed + self.plan.count
        return replace(self.plan, first_seed=first, count=self.validation)


class Tried(NamedTuple):
    """One trial.

    Parameters
    ----------
    number : int
        From 0 on.
    values : Values
        Of the settings that are searched.
    cost : float
        What was to be small; inf for settings that cannot be.
    success : float
        Share of the runs.
    """

    number: int
    values: Values
    cost: float
    success: float


def searched(
    tuning: Tuning, folder: Path, crew: Crew, told: Callable[[Tried], None]
) -> list[Tried]:
    """All trials, each kept in the folder."""
    OPTUNA.logging.set_verbosity(OPTUNA.logging.ERROR)
    sampler = OPTUNA.samplers.TPESampler(seed=tuning.seed)
    study = OPTUNA.create_study(sampler=sampler, direction="minimize")
    return list(_trials(tuning, folder, crew, study, told))


def _trials(
    tuning: Tuning, folder: Path, crew: Crew, study: Any, told: Callable[[Tried], None]
) -> Iterator[Tried]:
    method = tuning.plan.methods[0]
    start = {axis.name: value_of(method, axis.name) for axis in tuning.axes}
    within = all(axis.has(start[axis.name]) for axis in tuning.axes)
    if within:
        study.enqueue_trial(start)
    for number in range(tuning.trials):
        trial = study.ask() if number or within else None  # of a start beyond, it cannot be told
        values = start if trial is None else {one.name: one.suggested(trial) for one in tuning.axes}
        tried = _tried(tuning, number, values, folder, crew)
        if trial is not None:
            study.tell(trial, min(tried.cost, 1e6))
        told(tried)
        yield tried


def _tried(tuning: Tuning, number: int, values: Values, folder: Path, crew: Crew) -> Tried:
    """What comes of some settings."""
    try:
        method = with_values(tuning.plan.methods[0], tuning.name, values)
        work = Work(replace(tuning.plan, methods=(method,)), folder)
    except (ValueError, UnusableEstimator):  # settings that do not go together
        return Tried(number, values, np.inf, 0.0)
    work.go(crew, lambda _: None)
    rows = work.gather()
    success: Any = rows["success"].to_numpy()
    return Tried(number, values, cost_of(tuning, rows), float(success.mean()))


def cost_of(tuning: Tuning, rows: Any) -> float:
    """What is to be small."""
    success: Any = rows["success"].to_numpy()
    column = "time_to_1mm_s" if tuning.goal == "time" else "pose_error_mm"
    values: Floats = rows[column].to_numpy().astype(np.float64)
    failed = 2.0 * tuning.plan.duration if tuning.goal == "time" else FAILED_MM
    return float(np.mean(np.where(success, np.minimum(values, failed), failed)))


def best(tried: list[Tried]) -> Tried:
    """The trial that cost least, the first of those that are alike."""
    return min(tried, key=lambda one: (one.cost, one.number))
