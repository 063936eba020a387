"""Claims: a verdict depends on the number, the bound and the number of trials only."""

import json
import math
from dataclasses import asdict, replace
from typing import Any

import pytest

from rcmservo.paper import claims
from rcmservo.paper.claims import (
    FAILS,
    HOLDS,
    REMARK,
    SOFTWARE,
    UNDECIDED,
    Claim,
    ClaimRow,
    ClaimTable,
    claim_table,
    judge,
)
from rcmservo.paper.plan import Measurement, NotMeasured, Settings
from rcmservo.paper.report import first_page, list_traps

CLAIM = Claim("it is so", "<=", 2.0, "lemma-1", "mm", remark="{remark}")


def row(
    measured: float, claim: Claim = CLAIM, trials: int = 3, remark: str = "", **options: Any
) -> ClaimRow:
    """Return the row of a measurement, from a table with one claim."""
    one = Measurement("it", measured, range(trials), remark=remark, **options)
    texts = replace(claim_table().experiment["lemma-1"], claim={"it": claim})
    table = replace(claim_table(), experiment={"some": texts})
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(claims, "claim_table", lambda: table)
        return judge("some", 0, one, Settings())


AT_LEAST = replace(CLAIM, relation=">=")


@pytest.mark.parametrize(
    ("given", "verdict"),
    [
        (row(2.0), HOLDS),
        (row(2.1), FAILS),
        (row(2.1, AT_LEAST), HOLDS),
        (row(1.9, AT_LEAST), FAILS),
        (row(1.0, remark="but"), REMARK),
        (row(1.0, remark="but", remarked=False), HOLDS),
        (row(3.0, remark="but"), FAILS),
        (row(1.0, trials=1), None),
        (row(3.0, trials=2), None),
        (row(3.0, trials=0), FAILS),
        (row(3.0, replace(CLAIM, bound=None), bound=3.0), HOLDS),
    ],
)
def test_a_verdict_depends_on_number_bound_and_trials(given: ClaimRow, verdict: str | None) -> None:
    assert given.verdict == verdict
    json.dumps(asdict(given), allow_nan=False)


def test_trials_that_are_not_seeds_count() -> None:
    one = Measurement("it", 1.0, [0], trials=1000)
    assert (one.trials, one.seeds) == (1000, [0])


@pytest.mark.parametrize(
    ("given", "verdict", "remark"),
    [
        (row(1.0, interval=(0.5, 1.5)), HOLDS, ""),
        (row(1.0, interval=(0.5, 2.5)), REMARK, UNDECIDED),
        (row(3.0, interval=(1.5, 4.0)), FAILS, UNDECIDED),
        (row(3.0, interval=(2.5, 4.0)), FAILS, ""),
        (row(3.0, AT_LEAST, interval=(2.0, 4.0)), HOLDS, ""),
        (row(1.0, remark="but", interval=(0.5, 2.5)), REMARK, f"but; {UNDECIDED}"),
        (row(1.0, trials=2, interval=(0.5, 2.5)), None, ""),
    ],
)
def test_an_interval_that_contains_the_bound_is_a_remark(
    given: ClaimRow, verdict: str | None, remark: str
) -> None:
    assert (given.verdict, given.remark) == (verdict, remark)
    assert (given.interval is None) == (verdict is None)


def test_an_unbounded_interval_of_few_trials_is_undecided_and_not_reported() -> None:
    given = row(1.0, interval=(0.0, math.inf))
    assert (given.verdict, given.remark, given.interval) == (REMARK, UNDECIDED, None)
    json.dumps(asdict(given), allow_nan=False)


def test_an_interval_that_was_not_measured_is_an_error() -> None:
    with pytest.raises(NotMeasured, match="it is so, its interval: measured nan"):
        row(1.0, interval=(0.5, math.nan))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_a_measurement_that_is_not_finite_is_an_error(value: float) -> None:
    with pytest.raises(NotMeasured, match="it is so: measured"):
        row(value)


def test_a_claim_names_its_author() -> None:
    assert row(1.0).whose == "the paper's"
    assert row(1.0, replace(CLAIM, follows=True)).whose == "follows from the paper"
    assert row(1.0, replace(CLAIM, about=SOFTWARE)).whose == SOFTWARE


def test_every_key_of_the_table_exists_and_every_sentence_has_a_claim() -> None:
    table: ClaimTable = claim_table()
    subjects = set[str]()
    for name, texts in table.experiment.items():
        assert texts.quick.keys() <= texts.whole.keys(), name
        for key, one in texts.claim.items():
            subjects.add(one.about)
            assert one.about in (*table.sentence, SOFTWARE), (name, key)
            assert one.trap in (*table.trap, ""), (name, key)
            assert one.figure in (*texts.figure, ""), (name, key)
    assert subjects == {*table.sentence, SOFTWARE}


def test_the_first_page_has_one_row_per_sentence_with_a_table_of_its_cases() -> None:
    cases = [
        row(number, case=(name, column))
        for number, name, column in ((1.0, "a", "x"), (3.0, "a", "y"), (1.5, "b", "x"))
    ]
    other = row(0.5, replace(CLAIM, claim="it follows", follows=True))
    papers, software = first_page([*cases, other, row(1.0, replace(CLAIM, about=SOFTWARE))])
    (judged,) = papers
    wording = claim_table().sentence["lemma-1"].wording
    assert (judged.wording, judged.head.measured) == (wording, 1.0)
    assert [one.claim for one in judged.others] == ["it follows"]
    (table,) = judged.cases
    assert (table.rows, table.columns) == (["a", "b"], ["x", "y"])
    numbers = [[one and one.measured for one in cells] for cells in table.cells]
    assert numbers == [[1.0, 3.0], [1.5, None]]
    assert [one.head.claim for one in software] == ["it is so"]


def test_only_verdicts_confirm_or_refute_a_pitfall() -> None:
    trapped = replace(CLAIM, trap="T4")

    def verdict(trials: int, confirmed: bool) -> str:
        return list_traps([row(1.0, trapped, trials, confirmed=confirmed)])[0].verdict

    assert verdict(3, True) == "confirmed"
    assert verdict(3, False) == "refuted"
    assert verdict(1, True) == "too few trials"
    assert not list_traps([row(1.0, trapped, trapped=False)])
