"""What an experiment says: claims with a number, a bound and a verdict, and the figures that show
it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rcmservo.figures.charts import Figure
from rcmservo.interfaces import Floats

HOLDS, REMARK, FAILS = "holds", "holds with a remark", "does not hold"


@dataclass(frozen=True)
class Claim:
    """One sentence and what was measured of it: it holds if ``measured`` ``relation`` ``bound``.

    ``where`` in the paper it stands (or that it is ours); ``seeds`` the number came from;
    ``remark`` under which condition it holds, or why it does not; ``detail`` what else was seen;
    ``figure`` the name of the one that shows it; ``trap`` the number (T1, …) of the paper's pitfall
    that the number bears on, and whether it ``confirmed`` it.
    """

    claim: str
    where: str
    measured: float
    unit: str
    relation: Literal["<=", ">="]
    bound: float
    seeds: Sequence[int]
    remark: str = ""
    detail: str = ""
    figure: str = ""
    trap: str = ""
    confirmed: bool = True

    @property
    def holds(self) -> bool:
        """Whether the number keeps its bound; NaN never does."""
        return bool(
            self.measured <= self.bound if self.relation == "<=" else self.measured >= self.bound
        )

    @property
    def verdict(self) -> str:
        return FAILS if not self.holds else REMARK if self.remark else HOLDS

    def row(self, experiment: str) -> dict[str, Any]:
        """The claim as it stands in claims.json."""
        return {
            "experiment": experiment,
            "claim": self.claim,
            "where": self.where,
            "measured": float(self.measured) if np.isfinite(self.measured) else None,
            "unit": self.unit,
            "relation": self.relation,
            "bound": float(self.bound),
            "verdict": self.verdict,
            "seed": [int(seed) for seed in self.seeds],
            "remark": self.remark,
            "detail": self.detail,
            "figure": self.figure,
            "trap": self.trap,
            "trap_confirmed": bool(self.confirmed) if self.trap else None,
        }


@dataclass(frozen=True)
class Shown:
    """A figure in the report: its ``name`` in links, what of the paper it stands for, words, and
    chart or pictures."""

    name: str
    where: str
    caption: str
    seeds: Sequence[int]
    chart: Figure | None = None
    pictures: Sequence[Path] = ()


@dataclass(frozen=True)
class Chapter:
    """What an experiment found."""

    claims: list[Claim]
    figures: list[Shown]


@dataclass(frozen=True)
class Result:
    """What a task found, as plain numbers, and the folder with its record and pictures."""

    values: dict[str, Any]
    folder: Path


@dataclass(frozen=True)
class Task:
    """A piece of work that needs no other: ``function(folder, **arguments)`` gives plain numbers
    and fills the folder.

    ``cost`` is about how many seconds it takes; the long ones begin first.
    """

    name: str
    function: Callable[..., dict[str, Any]]
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    cost: float = 1.0


def rms(values: Floats) -> float:
    """Root mean square of all numbers."""
    return math.sqrt(float(np.mean(np.square(values))))


def median(values: Sequence[float] | Floats) -> float:
    """The median; NaN of nothing."""
    return float(np.median(values)) if len(values) else math.nan


Results = Mapping[str, Result]


@dataclass(frozen=True)
class Experiment:
    """An experiment of the paper: its settings, whole and reduced, the tasks they make, and the
    chapter they end in."""

    name: str
    title: str
    about: str
    whole: Any
    quick: Any
    tasks: Callable[[Any], list[Task]]
    chapter: Callable[[Any, Results], Chapter]
