"""Retries of tests in wall time: only a stall of the machine excuses a failed run."""

import pytest
from _pytest.outcomes import Skipped

import stalls
from stalls import MAX_ATTEMPTS, MIN_STALL_NS, StallMonitor, retry_after_stalls


def test_the_monitor_measures_a_stall() -> None:
    """The stall is a call that does not release the interpreter."""
    with StallMonitor() as monitor:
        sum(range(20_000_000))
    assert monitor.longest >= MIN_STALL_NS


class FixedStall(StallMonitor):
    """Monitor that reports a stall of fixed duration."""

    duration_ns = MIN_STALL_NS

    def _watch(self) -> None:
        self.longest = self.duration_ns


def test_a_failed_run_is_repeated_if_the_machine_stalled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stalls, "StallMonitor", FixedStall)
    runs = iter(range(2 * MAX_ATTEMPTS))
    assert retry_after_stalls(lambda: next(runs), lambda run: run == 2) == 2
    with pytest.raises(Skipped, match="stalled"):
        retry_after_stalls(lambda: next(runs), lambda run: False)
    assert next(runs) == 3 + MAX_ATTEMPTS


def test_a_failed_run_is_not_repeated_without_a_stall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stalls, "StallMonitor", FixedStall)
    monkeypatch.setattr(FixedStall, "duration_ns", MIN_STALL_NS - 1)
    runs = iter(range(MAX_ATTEMPTS))
    assert retry_after_stalls(lambda: next(runs), lambda run: False) == 0
    assert next(runs) == 1
