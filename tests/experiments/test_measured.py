"""What is measured of runs: of which of them, and never more than there was."""

from dataclasses import fields, replace

import numpy as np
import pytest

from rcmservo.experiments.harness.claims import NotMeasured
from rcmservo.experiments.harness.lab.random_observations import RandomObservations
from rcmservo.experiments.harness.lab.regulation import Regulated, Regulation, RegulationRun
from rcmservo.experiments.harness.lab.regulation_claims import falls_by_k_b
from rcmservo.experiments.potential import first_below

ONE = Regulated(**{one.name: 0.0 for one in fields(Regulated)})
SETTINGS = Regulation(seeds=(4, 5, 6))


def falling(slope: float) -> RegulationRun:
    """A run in which r fell at this speed; NaN if it never was saturated."""
    return RegulationRun("", replace(ONE, slopes=np.array([1.0, slope, 1.0])))


NEVER = RegulationRun("time ran out during exploration", None)


def test_a_claim_counts_the_runs_that_were_measured_and_names_how_many_were_not() -> None:
    claim = falls_by_k_b(SETTINGS, [falling(1.1), NEVER, falling(np.nan)], ("flow", ""))
    assert list(claim.seeds) == [4]
    assert claim.measured == pytest.approx(0.1)
    assert "not measured in 2 of 3 runs" in claim.detail


def test_where_no_run_was_measured_that_is_an_error_and_no_number() -> None:
    with pytest.raises(NotMeasured, match=r"the slope of r, in any run: measured nan"):
        falls_by_k_b(SETTINGS, [NEVER, NEVER, falling(np.nan)], ("flow", ""))


def test_an_error_that_never_gets_small_takes_for_ever() -> None:
    assert first_below(1.0, np.array([3.0, 2.0, 0.9, 0.1])) == 2.0
    assert first_below(1.0, np.array([3.0, 2.0, 1.0])) == np.inf


@pytest.mark.parametrize("wrong", [{"observations": 0}, {"estimator_time": -1.0}])
def test_random_observations_that_cannot_be_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"random.{next(iter(wrong))}"):
        RandomObservations(**wrong)  # pyright: ignore[reportArgumentType]
