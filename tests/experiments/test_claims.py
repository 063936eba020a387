"""Claims: a verdict follows from number, bound and how many trials there are, and from nothing
else."""

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from rcmservo.experiments.harness.claims import (
    FAILS,
    HOLDS,
    REMARK,
    UNDECIDED,
    Chapter,
    Claim,
    NotMeasured,
)
from rcmservo.experiments.harness.plain import built, plain
from rcmservo.experiments.harness.rows import ClaimRow, first_page, row_of, rows_of
from rcmservo.experiments.harness.sentences import OURS, SENTENCES
from rcmservo.experiments.harness.traps import traps_met


def claim(measured: float, relation: Any = "<=", remark: str = "", trials: int = 3) -> Claim:
    seeds = list(range(trials))
    return Claim("it is so", "lemma-1", measured, "mm", relation, 2.0, seeds, remark=remark)


@pytest.mark.parametrize(
    ("given", "verdict"),
    [
        (claim(2.0), HOLDS),
        (claim(2.1), FAILS),
        (claim(2.1, ">="), HOLDS),
        (claim(1.9, ">="), FAILS),
        (claim(1.0, remark="but"), REMARK),
        (claim(3.0, remark="but"), FAILS),
        (claim(1.0, trials=1), None),
        (claim(3.0, trials=2), None),
        (claim(3.0, trials=0), FAILS),
        (replace(claim(1.0, trials=1), trials=1000), HOLDS),
    ],
)
def test_a_verdict_follows_from_the_number_its_bound_and_the_trials(
    given: Claim, verdict: str | None
) -> None:
    assert given.verdict == verdict
    assert row_of("some", 0, given).verdict == verdict
    json.dumps(plain(row_of("some", 0, given)), allow_nan=False)


@pytest.mark.parametrize(
    ("given", "verdict", "remark"),
    [
        (replace(claim(1.0), interval=(0.5, 1.5)), HOLDS, ""),
        (replace(claim(1.0), interval=(0.5, 2.5)), REMARK, UNDECIDED),
        (replace(claim(3.0), interval=(1.5, 4.0)), FAILS, UNDECIDED),
        (replace(claim(3.0), interval=(2.5, 4.0)), FAILS, ""),
        (replace(claim(3.0, ">="), interval=(2.0, 4.0)), HOLDS, ""),
        (replace(claim(1.0, remark="but"), interval=(0.5, 2.5)), REMARK, f"but; {UNDECIDED}"),
        (replace(claim(1.0, trials=2), interval=(0.5, 2.5)), None, ""),
    ],
)
def test_an_interval_with_both_sides_of_the_bound_is_a_remark(
    given: Claim, verdict: str | None, remark: str
) -> None:
    row = row_of("some", 0, given)
    assert (row.verdict, row.remark) == (verdict, remark)
    assert row.interval == (None if verdict is None else given.interval)
    assert built(ClaimRow, json.loads(json.dumps(plain(row)))) == row


def test_an_interval_that_too_few_trials_leave_open_is_not_told_and_decides_nothing() -> None:
    row = row_of("some", 0, replace(claim(1.0), interval=(0.0, math.inf)))
    assert (row.verdict, row.remark, row.interval) == (REMARK, UNDECIDED, None)
    json.dumps(plain(row), allow_nan=False)


def test_an_interval_that_was_not_measured_is_an_error() -> None:
    with pytest.raises(NotMeasured, match="it is so, its interval: measured nan"):
        replace(claim(1.0), interval=(0.5, math.nan))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_a_measurement_that_is_not_finite_is_an_error_and_no_verdict(value: float) -> None:
    with pytest.raises(NotMeasured, match="it is so: measured"):
        claim(value)


def test_a_claim_is_about_a_sentence_of_the_paper_or_ours_and_says_whose_it_is() -> None:
    with pytest.raises(ValueError, match="no sentence"):
        replace(claim(1.0), about="lemma-2")
    assert claim(1.0).whose == "the paper's"
    assert replace(claim(1.0), follows=True).whose == "follows from the paper"
    assert replace(claim(1.0), about=OURS).whose == "ours"


def test_the_first_page_has_one_row_for_each_sentence_and_its_cases_in_one_small_table() -> None:
    cases = [
        replace(claim(number), case=(name, column))
        for number, name, column in ((1.0, "a", "x"), (3.0, "a", "y"), (1.5, "b", "x"))
    ]
    other = replace(claim(0.5), claim="it follows", follows=True)
    ours = replace(claim(1.0), about=OURS)
    papers, apart = first_page(rows_of({"some": Chapter([*cases, other, ours])}))
    (judged,) = papers
    assert (judged.words, judged.head.measured) == (SENTENCES["lemma-1"].words, 1.0)
    assert [row.claim for row in judged.others] == ["it follows"]
    (table,) = judged.cases
    assert (table.rows, table.columns) == (["a", "b"], ["x", "y"])
    numbers = [[row and row.measured for row in cells] for cells in table.cells]
    assert numbers == [[1.0, 3.0], [1.5, None]]
    assert [row.head.claim for row in apart] == ["it is so"]


def test_a_trap_is_confirmed_or_refuted_by_verdicts_only() -> None:
    def verdict(trials: int, confirmed: bool) -> str:
        met = replace(claim(1.0, trials=trials), trap="T4", confirmed=confirmed)
        return traps_met([row_of("some", 0, met)])[0].verdict

    assert verdict(3, True) == "confirmed"
    assert verdict(3, False) == "refuted"
    assert verdict(1, True) == "too few trials to tell"
