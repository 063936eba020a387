"""Parts of an experiment: settings, tasks, results, measurements of its claims, and figures."""

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
"""Settings of an experiment, for a whole or a reduced run, by name."""

Found = Mapping[str, Any]
"""Numbers, words, arrays, lists and tables that a task found, by name."""


class NotMeasured(RcmServoError):
    """A measurement that is missing or not finite, which gives no verdict."""

    def __init__(self, what: str, value: object) -> None:
        super().__init__(what, value)
        self.what, self.value = what, value

    def __str__(self) -> str:
        return f"{self.what}: measured {self.value}, which is not a finite number"


@dataclass(frozen=True)
class Task:
    """A piece of work that needs no other.

    Parameters
    ----------
    name : str
        Name of its folder, unique in the experiment.
    work : partial[Found]
        Function that returns the results.
    cost : float
        Approximate time in s; the long ones begin first.
    in_folder : bool
        True if the function takes its folder, to leave a record and pictures there.
    """

    name: str
    work: "partial[Found]"
    cost: float = 1.0
    in_folder: bool = False

    @classmethod
    def per_seed(
        cls,
        prefix: str,
        work: "partial[Found]",
        seeds: Iterable[int],
        cost: float = 1.0,
        in_folder: bool = False,
    ) -> "list[Task]":
        """Return one task for each seed, named `prefix`-seed, which is an argument of the work."""
        return [cls(f"{prefix}-{i}", partial(work, seed=i), cost, in_folder) for i in seeds]


@dataclass(frozen=True)
class Results:
    """Results of all tasks of an experiment.

    Parameters
    ----------
    found : Mapping[str, Found]
        Results by the tasks' names.
    folders : Mapping[str, Path]
        Folders with the tasks' records and pictures, by the tasks' names.
    """

    found: Mapping[str, Found]
    folders: Mapping[str, Path]

    def __getitem__(self, task: str) -> Found:
        return self.found[task]

    def per_seed(self, prefix: str, seeds: Iterable[int]) -> list[Found]:
        """Return the results of the tasks `prefix`-seed."""
        return [self.found[f"{prefix}-{seed}"] for seed in seeds]


class Measurement:
    """Measured number of a claim in one case.

    Parameters
    ----------
    claim : str
        Key of the claim in its experiment's table.
    value : float
        Number, finite.
    seeds : iterable of int
        Seeds of the trials; none for a computation without chance.
    interval : sequence of float, optional
        Confidence interval of 95 %, which may follow the number; an end is infinite if the trials
        are too few for it.
    case : sequence of str
        Row and column among the cases of the same claim.
    trials : int, optional
        Independent trials, where they are not the seeds.
    bound : float, optional
        Bound, where the table has none.
    remarked : bool
        False if the claim's remark does not apply.
    trapped : bool
        False if this case does not bear on the claim's pitfall.
    confirmed : bool
        True if the number confirms that pitfall.
    words : object
        Values for the texts of the claim.
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
        **words: object,
    ) -> None:
        self.claim, self.value = claim, float(value)
        self.seeds = [int(seed) for seed in seeds]
        self.ends = [float(end) for end in interval[-2:]]
        row, column = (*case, "", "")[:2]
        self.case = row, column
        self.trials = len(self.seeds) if trials is None else trials
        self.bound, self.words = bound, words
        self.remarked, self.trapped, self.confirmed = remarked, trapped, bool(confirmed)


@dataclass(frozen=True)
class Drawn:
    """A figure of the report.

    Parameters
    ----------
    name : str
        Key in the table of claims, and the name in links and figures.json.
    seeds : Sequence[int]
        Seeds named below it; empty for a computation without chance.
    chart : Figure or None
        None where it consists of pictures alone.
    pictures : Sequence[Path]
        PNG files that stand before the chart.
    words : Mapping[str, object]
        Values for the caption's text.
    key : str
        Key in the table of claims, where that is not the name.
    """

    name: str
    seeds: Sequence[int]
    chart: Figure | None = None
    pictures: Sequence[Path] = ()
    words: Mapping[str, object] = field(default_factory=dict[str, object])
    key: str = ""
