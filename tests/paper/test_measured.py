"""What is measured of runs: of which of them, and never more than there was."""

import numpy as np
import pytest

from rcmservo.paper.lab.random_observations import RandomObservations
from rcmservo.paper.lab.regulation import falls_by_k_b
from rcmservo.paper.plan import Found, NotMeasured
from rcmservo.paper.potential import first_below
from rcmservo.paper.statistics import column

SEEDS = (4, 5, 6)
NEVER = {"cause": "time ran out during exploration", "began": None}


def falling(slope: float) -> Found:
    """A run in which r fell at this speed; NaN if it never was saturated."""
    return {"cause": "", "began": 0.0, "slope": slope}


def test_a_claim_counts_the_runs_that_were_measured_and_names_how_many_were_not() -> None:
    one = falls_by_k_b([falling(1.1), NEVER, falling(np.nan)], SEEDS, "flow")
    assert one.seeds == [4]
    assert one.value == pytest.approx(0.1)
    assert "not measured in 2 of 3 runs" in str(one.words["missing"])


def test_where_no_run_was_measured_that_is_an_error_and_no_number() -> None:
    with pytest.raises(NotMeasured, match=r"the slope of r, in any run: measured nan"):
        falls_by_k_b([NEVER, NEVER, falling(np.nan)], SEEDS, "flow")


def test_a_number_that_a_result_lacks_is_not_a_number_of_a_column() -> None:
    found = column([{"a": {"b": 1.0}}, {"a": {"b": None}}], "a", "b")
    np.testing.assert_array_equal(found, [1.0, np.nan])


def test_an_error_that_never_gets_small_takes_for_ever() -> None:
    assert first_below(1.0, np.array([3.0, 2.0, 0.9, 0.1])) == 2.0
    assert first_below(1.0, np.array([3.0, 2.0, 1.0])) == np.inf


@pytest.mark.parametrize("wrong", [{"observations": 0}, {"estimator_time": -1.0}])
def test_random_observations_that_cannot_be_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"random.{next(iter(wrong))}"):
        RandomObservations(**wrong)  # pyright: ignore[reportArgumentType]
