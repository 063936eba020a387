"""benchmarks/wrong_frames.py: estimators that ignore wrong frames by themselves, without checks."""

import pytest
from wrong_frames import one

SEEDS = range(7100, 7108)


def count_arrivals(estimator: str) -> int:
    """Return how many runs with 10 % of wrong frames end within 3 mm, without any check."""
    return sum(one(seed, estimator, 0.1, checks=False)[0] <= 3.0 for seed in SEEDS)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["dlt", "correntropy"])
def test_wrong_frames_do_not_mislead_a_robust_estimator(estimator: str) -> None:
    assert count_arrivals(estimator) >= 7


@pytest.mark.slow
def test_they_mislead_a_kalman_filter() -> None:
    assert count_arrivals("kalman") <= 6


def test_a_single_wrong_frame_changes_nothing() -> None:
    error_mm, stops = one(7100, "dlt", None, checks=True)
    assert error_mm < 1.0 and not stops
