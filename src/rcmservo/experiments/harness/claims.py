"""What an experiment says: claims with a number, a bound and a verdict, and the figures that show
them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.experiments.harness.sentences import OURS, SENTENCES
from rcmservo.figures.charts import Figure

HOLDS, REMARK, FAILS = "holds", "holds with a remark", "does not hold"
VERDICTS = (HOLDS, REMARK, FAILS)

ENOUGH = 3
"""Trials from which on a number is called a verdict."""

UNDECIDED = "the interval of 95 % holds both sides of the bound"
"""The remark on a number that chance may have put on its side."""


class NotMeasured(RcmServoError):
    """A measurement that is missing or not finite: no verdict can come of it."""

    def __init__(self, what: str, value: object) -> None:
        super().__init__(what, value)
        self.what, self.value = what, value

    def __str__(self) -> str:
        return f"{self.what}: measured {self.value}, which is not a finite number"


@dataclass(frozen=True)
class Claim:
    """One sentence, and whether what was measured of it keeps a bound."""

    claim: str
    """What is measured, in words that are true or false."""
    about: str
    """The sentence of the paper that it bears on, a key of SENTENCES; or OURS."""
    measured: float
    """The number; it must be finite."""
    unit: str
    """Of ``measured`` and ``bound``, as it is printed; empty for a plain number."""
    relation: Literal["<=", ">="]
    """How ``measured`` must stand to ``bound`` for the claim to hold."""
    bound: float
    """What ``measured`` is compared with."""
    seeds: Sequence[int] = ()
    """What the number came from; empty for a computation without chance."""
    interval: tuple[float, float] | None = None
    """Between what the number is, with 95 %: an end is infinite where the trials are too few for
    it. None where that is not told."""
    follows: bool = False
    """Whether it only follows from the paper's sentence, instead of saying the same."""
    case: tuple[str, str] = ("", "")
    """Which of several cases of the same words: row and column of their table."""
    trials: int | None = None
    """Independent trials behind the number, where they are not the seeds."""
    remark: str = ""
    """Under which condition it holds, or why it does not."""
    detail: str = ""
    """What else was seen."""
    figure: str = ""
    """The name of the figure that shows it."""
    trap: str = ""
    """The paper's pitfall (T1, ...) that the number bears on."""
    confirmed: bool = True
    """Whether the number confirms that pitfall."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.measured):
            raise NotMeasured(self.claim, self.measured)
        for end in self.interval or ():
            if math.isnan(end):
                raise NotMeasured(f"{self.claim}, its interval", end)
        if self.about != OURS and self.about not in SENTENCES:
            raise ValueError(f"no sentence of the paper is called {self.about!r}")

    @property
    def number(self) -> int:
        """How many trials the number came from."""
        return len(self.seeds) if self.trials is None else self.trials

    @property
    def verdict(self) -> str | None:
        """What the number makes of the claim; None where one or two trials cannot tell."""
        if self._few:
            return None
        return (REMARK if self.remarks else HOLDS) if self._keeps(self.measured) else FAILS

    @property
    def remarks(self) -> str:
        """Its remark, and whether the number can tell at all."""
        sides = set[bool]() if self._few else {self._keeps(end) for end in self.interval or ()}
        return "; ".join(filter(None, (self.remark, UNDECIDED if len(sides) == 2 else "")))

    @property
    def sure(self) -> tuple[float, float] | None:
        """Its interval; None where the trials are too few for one."""
        if self._few or self.interval is None or not np.isfinite(self.interval).all():
            return None
        return self.interval

    @property
    def _few(self) -> bool:
        return 0 < self.number < ENOUGH

    def _keeps(self, number: float) -> bool:
        """Whether a number keeps the bound."""
        return number <= self.bound if self.relation == "<=" else number >= self.bound

    @property
    def whose(self) -> str:
        """Whose sentence is judged."""
        if self.about == OURS:
            return "ours"
        return "follows from the paper" if self.follows else "the paper's"

    @property
    def where(self) -> str:
        """Where in the paper it stands."""
        return OURS if self.about == OURS else SENTENCES[self.about].where


@dataclass(frozen=True)
class Shown:
    """A figure in the report."""

    name: str
    """In links and in figures.json, after its experiment's name."""
    where: str
    """What of the paper it stands for (Fig. 14, III-A), or another heading; its caption begins with
    it."""
    caption: str
    """What it shows, in sentences."""
    seeds: Sequence[int]
    """Named beneath it; empty for a computation without chance."""
    chart: Figure | None = None
    """None where it consists of pictures alone."""
    pictures: Sequence[Path] = ()
    """PNG files that stand before the chart; often none."""


@dataclass(frozen=True)
class Chapter:
    """What an experiment found."""

    claims: list[Claim]
    """In the order of the report."""
    figures: list[Shown] = field(default_factory=list[Shown])
    """In the order of the report."""
