"""Parts of an experiment: tasks, their results, measurements of claims, and figures."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.figures.charts import Figure

Settings = SimpleNamespace
"""Settings of an experiment, for a full or a reduced run, by name."""

TaskResult = Mapping[str, Any]
"""Results of a task by name: numbers, texts, arrays, lists and tables."""


Texts = dict[str, Any]
"""Values for the braces in the texts of a claim or a figure, by name."""


class NotMeasured(RcmServoError):
    """Raised for a measurement that is missing or not finite, so that there is no verdict."""

    def __init__(self, quantity: str, value: object) -> None:
        super().__init__(quantity, value)
        self.quantity, self.value = quantity, value

    def __str__(self) -> str:
        return f"{self.quantity}: measured {self.value}, which is not a finite number"


@dataclass(frozen=True)
class Task:
    """Work that does not depend on other tasks.

    Parameters
    ----------
    name : str
        Name of the folder, unique in the experiment.
    work : partial[TaskResult]
        Function that returns the results.
    cost : float
        Approximate time in s; long tasks start first.
    in_folder : bool
        True if the function takes a folder, in which it writes a record and images.
    """

    name: str
    work: "partial[TaskResult]"
    cost: float = 1.0
    in_folder: bool = False

    @classmethod
    def per_seed(
        cls,
        prefix: str,
        work: "partial[TaskResult]",
        seeds: Iterable[int],
        cost: float = 1.0,
        in_folder: bool = False,
    ) -> "list[Task]":
        """Return one task per seed, named `prefix`-seed; `work` receives the argument `seed`."""
        return [cls(f"{prefix}-{i}", partial(work, seed=i), cost, in_folder) for i in seeds]


@dataclass(frozen=True)
class Results:
    """Results of all tasks of an experiment.

    Parameters
    ----------
    by_task : Mapping[str, TaskResult]
        Results by name of the task.
    folders : Mapping[str, Path]
        Folders with records and images, by name of the task.
    """

    by_task: Mapping[str, TaskResult]
    folders: Mapping[str, Path]

    def __getitem__(self, task: str) -> TaskResult:
        return self.by_task[task]

    def per_seed(self, prefix: str, seeds: Iterable[int]) -> list[TaskResult]:
        """Return the results of the tasks `prefix`-seed."""
        return [self.by_task[f"{prefix}-{seed}"] for seed in seeds]


class Measurement:
    """Measured number of a claim in one case.

    Parameters
    ----------
    claim : str
        Key of the claim in the table of the experiment.
    value : float
        Measured number, finite.
    seeds : iterable of int
        Seeds of the trials; empty for a deterministic computation.
    interval : sequence of float, optional
        95 % confidence interval, as the last two entries; an end is infinite if the trials are too
        few for it.
    case : sequence of str
        Row and column in the table of cases of the claim.
    trials : int, optional
        Number of independent trials; by default the number of seeds.
    bound : float, optional
        Bound, if the table has none.
    remarked : bool
        False if the remark of the claim does not apply to this case.
    trapped : bool
        False if this case does not concern the pitfall of the claim.
    confirmed : bool
        True if the number confirms the pitfall.
    texts : object
        Values for the braces in the texts of the claim.
    """

    def __init__(
        self,
        claim: str,
        value: float,
        seeds: Iterable[int] = (),
        *,
        interval: Sequence[float] = (),
        case: Sequence[str] = (),
        trials: int | None = None,
        bound: float | None = None,
        remarked: bool = True,
        trapped: bool = True,
        confirmed: bool | np.bool = True,
        **texts: object,
    ) -> None:
        self.claim, self.value, self.seeds = claim, float(value), [int(seed) for seed in seeds]
        self.ends = [float(end) for end in interval[-2:]]
        row, column = (*case, "", "")[:2]
        self.case, self.bound, self.texts = (row, column), bound, texts
        self.trials = len(self.seeds) if trials is None else trials
        self.remarked, self.trapped, self.confirmed = remarked, trapped, bool(confirmed)


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the report.

    Parameters
    ----------
    name : str
        Name in links and figures.json, and key in the table of claims.
    seeds : Sequence[int]
        Seeds that the report states; empty for a deterministic computation.
    chart : Figure or None
        Chart; None if the figure consists of images only.
    pictures : Sequence[Path]
        PNG files, placed before the chart.
    texts : Mapping[str, object]
        Values for the braces in the caption.
    key : str
        Key in the table of claims if it differs from `name`.
    """

    name: str
    seeds: Sequence[int]
    chart: Figure | None = None
    pictures: Sequence[Path] = ()
    texts: Mapping[str, object] = field(default_factory=dict[str, object])
    key: str = ""
