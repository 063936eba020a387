"""Measurements over runs: runs without a result are excluded and counted."""

import numpy as np
import pytest

from rcmservo.paper.lab.random_observations import RandomObservations
from rcmservo.paper.lab.regulation import measure_fall
from rcmservo.paper.plan import NotMeasured, TaskResult
from rcmservo.paper.potential_claims import first_below
from rcmservo.paper.stability_claims import above_noise
from rcmservo.paper.statistics import column

SEEDS = (4, 5, 6)
NEVER = {"cause": "time ran out during exploration", "began": None}


def falling(slope: float) -> TaskResult:
    """Return a run in which the error of r fell at `slope` (px/s); NaN if it never saturated."""
    return {"cause": "", "began": 0.0, "slope": slope}


def test_a_claim_excludes_runs_without_a_result_and_reports_their_number() -> None:
    measurement = measure_fall([falling(1.1), NEVER, falling(np.nan)], SEEDS, "flow")
    assert measurement.seeds == [4]
    assert measurement.value == pytest.approx(0.1)
    assert "not measured in 2 of 3 runs" in str(measurement.texts["missing"])


def test_a_claim_without_any_measured_run_is_an_error() -> None:
    with pytest.raises(NotMeasured, match=r"the slope of r, in any run: measured nan"):
        measure_fall([NEVER, NEVER, falling(np.nan)], SEEDS, "flow")


def test_a_missing_result_is_nan_in_a_column() -> None:
    values = column([{"a": {"b": 1.0}}, {"a": {"b": None}}], "a", "b")
    np.testing.assert_array_equal(values, [1.0, np.nan])


def test_an_error_that_stays_above_the_bound_takes_infinite_time() -> None:
    assert first_below(1.0, np.array([3.0, 2.0, 0.9, 0.1])) == 2.0
    assert first_below(1.0, np.array([3.0, 2.0, 1.0])) == np.inf


@pytest.mark.parametrize("invalid", [{"observations": 0}, {"estimator_time": -1.0}])
def test_invalid_settings_of_random_observations_are_rejected(invalid: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"random.{next(iter(invalid))}"):
        RandomObservations(**invalid)  # pyright: ignore[reportArgumentType]


def test_a_run_that_never_servoed_leaves_out_the_experiment_only() -> None:
    """An empty result once ended the whole report, as the least value of no frame."""
    with pytest.raises(NotMeasured, match="least in SERVO with an error above the noise"):
        above_noise({"least": np.array([]), "in_noise": np.array([])}, "least")
