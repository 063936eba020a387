"""Table of claims (claims.toml), and verdicts on their measurements.

A row of the table states the measured quantity, the sentence of the paper that it concerns, and the
bound. An experiment returns a `Measurement` for it; `judge` combines both into a row of
claims.json.
"""

import math
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any, Literal

from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import parse_toml
from rcmservo.paper.plan import Measurement, NotMeasured, Settings

HOLDS, REMARK, FAILS = "holds", "holds with a remark", "does not hold"
SOFTWARE = "rcmservo"
"""Subject and author of a claim about this software, not about the paper."""
MIN_TRIALS = 3
"""Smallest number of trials that allows a verdict."""
UNDECIDED = "the 95 % interval contains the bound"


@dataclass(frozen=True)
class Sentence:
    """A sentence of the paper that can be measured.

    Parameters
    ----------
    where : str
        Section, equation or figure of the paper.
    wording : str
        Wording of the paper, shortened.
    """

    where: str
    wording: str


@dataclass(frozen=True)
class Claim:
    """A row of the table; braces in its texts refer to settings and to texts of the measurement.

    Parameters
    ----------
    claim : str
        Statement that the measurement confirms or refutes.
    relation : Literal['<=', '>=']
        Relation of the measured number to the bound if the claim holds.
    bound : float or None
        Bound; None if the experiment computes it from its settings.
    about : str
        Key of the sentence of the paper, or `SOFTWARE`.
    unit : str
        Unit of number and bound; empty for a dimensionless number.
    follows : bool
        True if the claim is a consequence of the sentence, not its wording.
    remark : str
        Condition under which the claim holds, or reason why it does not.
    detail : str
        Further observations.
    figure : str
        Key of the figure that shows the measurement.
    trap : str
        Key of the pitfall of the paper that the measurement concerns.
    """

    claim: str
    relation: Literal["<=", ">="]
    bound: float | None = None
    about: str = SOFTWARE
    unit: str = ""
    follows: bool = False
    remark: str = ""
    detail: str = ""
    figure: str = ""
    trap: str = ""


@dataclass(frozen=True)
class Caption:
    """Heading and caption of a figure.

    Parameters
    ----------
    where : str
        Corresponding part of the paper, or another heading.
    caption : str
        Description of the figure.
    """

    where: str
    caption: str


@dataclass(frozen=True)
class ExperimentTexts:
    """Texts and settings of an experiment.

    Parameters
    ----------
    title : str
        Heading of the experiment in the report.
    about : str
        Description of the experiment.
    whole : dict[str, Any]
        Settings of a full run.
    claim : dict[str, Claim]
        Claims by key.
    figure : dict[str, Caption]
        Captions of figures by key.
    quick : dict[str, Any]
        Settings that differ in a reduced run.
    """

    title: str
    about: str
    whole: dict[str, Any]
    claim: dict[str, Claim]
    figure: dict[str, Caption]
    quick: dict[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class ClaimTable:
    """Content of claims.toml.

    Parameters
    ----------
    trap : dict[str, str]
        Pitfalls of the paper, from a critical reading.
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
    """Return the content of claims.toml, read once."""
    data = resources.files("rcmservo.paper").joinpath("claims.toml").read_bytes()
    return decode_settings(ClaimTable, parse_toml(data), "claims")


@dataclass(frozen=True, kw_only=True)
class ClaimRow(Claim):
    """A row of claims.json: a claim with its texts filled in, its measurement and its verdict.

    Parameters
    ----------
    experiment : str
        Name of the experiment.
    number : int
        Index among the claims of the experiment.
    whose : str
        Author of the claim: `SOFTWARE`, "the paper's", or "follows from the paper".
    case : tuple[str, str]
        Row and column in the table of cases; empty if the claim has one case.
    where : str
        Location of the sentence in the paper, or `SOFTWARE`.
    measured : float
        Measured number, in ``unit``.
    interval : tuple[float, float] or None
        95 % confidence interval; None if there is none or the trials are too few for it.
    verdict : str or None
        `HOLDS`, `REMARK` or `FAILS`; None for one or two trials.
    trials : int
        Number of trials; 0 for a deterministic computation.
    seed : list[int]
        Seeds of the trials; empty for a deterministic computation.
    trap_confirmed : bool or None
        True if the measurement confirms the pitfall; None without a pitfall or a verdict.
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
        """Anchor of the claim in the report."""
        return f"{self.experiment}/claim-{self.number}"


def judge(experiment: str, number: int, measurement: Measurement, settings: Settings) -> ClaimRow:
    """Return the row of claims.json for a measurement.

    Parameters
    ----------
    experiment
        Name of the experiment.
    number
        Index of the measurement in the experiment.
    measurement
        Measured number of a claim in one case.
    settings
        Settings of the experiment.

    Returns
    -------
    ClaimRow
        Claim with its verdict.

    Raises
    ------
    NotMeasured
        If the number is not finite, or an end of its interval is NaN.
    ValueError
        If neither the table nor the measurement has a bound.
    """
    table = claim_table()
    row = table.experiment[experiment].claim[measurement.claim]
    texts = {**vars(settings), **measurement.texts}
    statement, detail = row.claim.format(**texts), row.detail.format(**texts)
    value, ends = measurement.value, measurement.ends
    bound = measurement.bound if row.bound is None else row.bound
    if bound is None:
        raise ValueError(
            f"{experiment}, {measurement.claim}: neither table nor measurement has a bound"
        )
    if not math.isfinite(value):
        raise NotMeasured(statement, value)
    if any(math.isnan(end) for end in ends):
        raise NotMeasured(f"{statement}, its interval", math.nan)

    def holds(number: float) -> bool:
        return number <= bound if row.relation == "<=" else number >= bound

    has_few_trials = 0 < measurement.trials < MIN_TRIALS
    is_undecided = not has_few_trials and len({holds(end) for end in ends}) == 2
    condition = row.remark.format(**texts) if measurement.remarked else ""
    remark = "; ".join(filter(None, (condition, UNDECIDED if is_undecided else "")))
    verdict = None if has_few_trials else FAILS if not holds(value) else REMARK if remark else HOLDS
    trap = row.trap if measurement.trapped else ""
    low, high = ends or (math.inf, math.inf)
    filled = dict[str, Any](
        claim=statement, detail=detail, remark=remark, trap=trap, bound=float(bound)
    )
    concerns_software = row.about == SOFTWARE
    papers_author = "follows from the paper" if row.follows else "the paper's"
    return ClaimRow(
        **{**vars(row), **filled},
        experiment=experiment,
        number=number,
        whose=SOFTWARE if concerns_software else papers_author,
        case=measurement.case,
        where=SOFTWARE if concerns_software else table.sentence[row.about].where,
        measured=value,
        interval=(low, high) if not has_few_trials and math.isfinite(high - low) else None,
        verdict=verdict,
        trials=measurement.trials,
        seed=measurement.seeds,
        trap_confirmed=measurement.confirmed if trap and verdict is not None else None,
    )
