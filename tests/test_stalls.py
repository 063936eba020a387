"""Retries of tests in wall time: only a stall or a busy machine excuses a failed run."""

import os

import pytest
from _pytest.outcomes import Skipped

import stalls
from stalls import MAX_ATTEMPTS, MAX_BUSY_FRACTION, MIN_STALL_NS, StallMonitor, retry_after_stalls


def test_the_monitor_measures_a_stall() -> None:
    """The stall is a call that does not release the interpreter."""
    with StallMonitor() as monitor:
        sum(range(20_000_000))
    assert monitor.longest >= MIN_STALL_NS


def test_the_monitor_measures_how_busy_the_processors_are() -> None:
    with StallMonitor() as monitor:
        sum(range(20_000_000))
    assert 0.9 / len(os.sched_getaffinity(0)) <= monitor.busy_fraction <= 1.0


class FixedStall(StallMonitor):
    """Monitor that reports a stall of fixed duration and a fixed load."""

    duration_ns = MIN_STALL_NS
    load = 0.0

    def _watch(self) -> None:
        self.longest = self.duration_ns

    def __exit__(self, *error: object) -> None:
        super().__exit__(*error)
        self.busy_fraction = self.load


@pytest.mark.parametrize(
    ("duration_ns", "load"), [(MIN_STALL_NS, 0.0), (MIN_STALL_NS - 1, MAX_BUSY_FRACTION)]
)
def test_a_failed_run_is_repeated_if_the_machine_stalled_or_was_busy(
    monkeypatch: pytest.MonkeyPatch, duration_ns: int, load: float
) -> None:
    monkeypatch.setattr(stalls, "StallMonitor", FixedStall)
    monkeypatch.setattr(FixedStall, "duration_ns", duration_ns)
    monkeypatch.setattr(FixedStall, "load", load)
    runs = iter(range(2 * MAX_ATTEMPTS))
    assert retry_after_stalls(lambda: next(runs), lambda run: run == 2) == 2
    with pytest.raises(Skipped, match="stalled"):
        retry_after_stalls(lambda: next(runs), lambda run: False)
    assert next(runs) == 3 + MAX_ATTEMPTS


def test_a_failed_run_is_not_repeated_without_a_stall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stalls, "StallMonitor", FixedStall)
    monkeypatch.setattr(FixedStall, "duration_ns", MIN_STALL_NS - 1)
    monkeypatch.setattr(FixedStall, "load", MAX_BUSY_FRACTION - 0.01)
    runs = iter(range(MAX_ATTEMPTS))
    assert retry_after_stalls(lambda: next(runs), lambda run: False) == 0
    assert next(runs) == 1
