"""The table of claims, claims.toml, and the verdicts on what was measured.

A row of the table says what is measured, about which sentence of the paper, and the bound. An
experiment gives a `Measurement` of it, and `judge` makes of both a row of claims.json.
"""

import math
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any, Literal

from rcmservo.config.strict_decoding import decode
from rcmservo.config.texts import toml
from rcmservo.paper.plan import Measurement, NotMeasured, Settings

HOLDS, REMARK, FAILS = "holds", "holds with a remark", "does not hold"
VERDICTS = (HOLDS, REMARK, FAILS)
OURS = "ours"
"""Subject of a claim of this software, not of the paper."""
MIN_TRIALS = 3
"""Trials from which on a number has a verdict."""
UNDECIDED = "the interval of 95 % holds both sides of the bound"


@dataclass(frozen=True)
class Sentence:
    """A sentence of the paper that can be measured.

    Parameters
    ----------
    where : str
        Section, equation or figure.
    words : str
        Wording of the paper, shortened.
    """

    where: str
    words: str


@dataclass(frozen=True)
class Claim:
    """A row of the table. Its texts may hold settings and measured words in braces.

    Parameters
    ----------
    claim : str
        Measured statement, which is true or false.
    relation : Literal['<=', '>=']
        Relation of the measured number to the bound if the claim holds.
    bound : float or None
        Bound; None in a table whose experiment computes it from its settings.
    about : str
        Key of the paper's sentence, or OURS.
    unit : str
        Unit of number and bound; empty for a plain number.
    follows : bool
        True if the claim only follows from the paper's sentence.
    remark : str
        Condition under which it holds, or the reason why it does not.
    detail : str
        Further observations.
    figure : str
        Key of the figure that shows it.
    trap : str
        Key of the pitfall of the paper that the number bears on.
    """

    claim: str
    relation: Literal["<=", ">="]
    bound: float | None = None
    about: str = OURS
    unit: str = ""
    follows: bool = False
    remark: str = ""
    detail: str = ""
    figure: str = ""
    trap: str = ""


@dataclass(frozen=True)
class Caption:
    """Text of a figure.

    Parameters
    ----------
    where : str
        Part of the paper that it stands for, or another heading.
    caption : str
        Description in sentences.
    """

    where: str
    caption: str


@dataclass(frozen=True)
class ExperimentTexts:
    """Texts and settings of an experiment.

    Parameters
    ----------
    title : str
        Heading of its chapter.
    about : str
        Description in sentences.
    whole : dict[str, Any]
        Settings of a whole run.
    claim : dict[str, Claim]
        Claims by their keys.
    figure : dict[str, Caption]
        Figures by their names.
    quick : dict[str, Any]
        Settings in which a reduced run differs.
    """

    title: str
    about: str
    whole: dict[str, Any]
    claim: dict[str, Claim]
    figure: dict[str, Caption]
    quick: dict[str, Any] = field(default_factory=dict[str, Any])

    def settings(self, quick: bool) -> Settings:
        """Return the settings of a whole or a reduced run."""
        return Settings(**{**self.whole, **(self.quick if quick else {})})


@dataclass(frozen=True)
class ClaimTable:
    """Content of claims.toml.

    Parameters
    ----------
    trap : dict[str, str]
        Pitfalls of the project's critical reading of the paper.
    sentence : dict[str, Sentence]
        Sentences of the paper, in its order.
    experiment : dict[str, ExperimentTexts]
        Experiments, in the order of the report.
    """

    trap: dict[str, str]
    sentence: dict[str, Sentence]
    experiment: dict[str, ExperimentTexts]


@cache
def claim_table() -> ClaimTable:
    """Return the table of claims."""
    data = resources.files("rcmservo.paper").joinpath("claims.toml").read_bytes()
    return decode(ClaimTable, toml(data), "claims")


@dataclass(frozen=True, kw_only=True)
class ClaimRow(Claim):
    """A claim as it stands in claims.json: its row of the table, texts filled in, and judged.

    Parameters
    ----------
    experiment : str
        Name of its experiment.
    number : int
        Index among the claims of its experiment.
    whose : str
        Author of the sentence that is judged: ours, the paper's, or follows from the paper.
    case : tuple[str, str]
        Row and column among the cases of the same words; empty where it has none.
    where : str
        Place of that sentence in the paper, or OURS.
    measured : float
        Number, in ``unit``.
    interval : tuple[float, float] or None
        Confidence interval of 95 %; None if there is none or the trials are too few for it.
    verdict : str or None
        One of VERDICTS; None for one or two trials.
    trials : int
        Number of trials; 0 for a computation without chance.
    seed : list[int]
        Seeds of the trials; empty for a computation without chance.
    trap_confirmed : bool or None
        True if the number confirms that pitfall; None without a pitfall or a verdict.
    """

    experiment: str
    number: int
    whose: str
    case: tuple[str, str]
    where: str
    measured: float
    interval: tuple[float, float] | None
    verdict: str | None
    trials: int
    seed: list[int]
    trap_confirmed: bool | None

    @property
    def anchor(self) -> str:
        """Link to the claim in the report."""
        return f"{self.experiment}/claim-{self.number}"


def judge(experiment: str, number: int, one: Measurement, settings: Settings) -> ClaimRow:
    """Return the row of claims.json for a measurement; `NotMeasured` if it is not finite."""
    table = claim_table()
    row = table.experiment[experiment].claim[one.claim]
    texts = {**vars(settings), **one.words}
    claim, detail = row.claim.format(**texts), row.detail.format(**texts)
    bound = one.bound if row.bound is None else row.bound
    if bound is None:
        raise ValueError(f"{experiment}, {one.claim}: neither table nor measurement has a bound")
    if not math.isfinite(one.value):
        raise NotMeasured(claim, one.value)
    for end in one.ends:
        if math.isnan(end):
            raise NotMeasured(f"{claim}, its interval", end)

    def keeps(value: float) -> bool:
        return value <= bound if row.relation == "<=" else value >= bound

    few = 0 < one.trials < MIN_TRIALS
    undecided = not few and len({keeps(end) for end in one.ends}) == 2
    remarks = [row.remark.format(**texts) if one.remarked else "", UNDECIDED if undecided else ""]
    remark = "; ".join(filter(None, remarks))
    verdict = None if few else FAILS if not keeps(one.value) else REMARK if remark else HOLDS
    trap = row.trap if one.trapped else ""
    low, high = one.ends or (math.inf, math.inf)
    filled: dict[str, Any] = {"claim": claim, "detail": detail, "remark": remark, "trap": trap}
    filled = vars(row) | filled | {"bound": float(bound)}
    return ClaimRow(
        **filled,
        experiment=experiment,
        number=number,
        whose=_author(row),
        case=one.case,
        where=OURS if row.about == OURS else table.sentence[row.about].where,
        measured=one.value,
        interval=(low, high) if not few and math.isfinite(high - low) else None,
        verdict=verdict,
        trials=one.trials,
        seed=one.seeds,
        trap_confirmed=one.confirmed if trap and verdict is not None else None,
    )


def _author(row: Claim) -> str:
    """Return the author of the sentence that is judged."""
    if row.about == OURS:
        return OURS
    return "follows from the paper" if row.follows else "the paper's"
