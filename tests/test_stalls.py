"""What tests in wall time lean on: only a machine that stood still excuses a run."""

import pytest
from _pytest.outcomes import Skipped

import stalls
from stalls import LONG, TRIES, Witness, undisturbed


def test_the_witness_notes_what_kept_it_waiting() -> None:
    """Here a call that does not let go of the interpreter."""
    with Witness() as witness:
        sum(range(20_000_000))
    assert witness.longest >= LONG


class Still(Witness):
    """One that was kept waiting as long as it is told to."""

    kept = LONG

    def _watch(self) -> None:
        self.longest = self.kept


def test_a_run_that_did_not_arrive_is_made_again_where_the_machine_stood_still(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stalls, "Witness", Still)
    runs = iter(range(2 * TRIES))
    assert undisturbed(lambda: next(runs), lambda run: run == 2) == 2
    with pytest.raises(Skipped, match="stood still"):
        undisturbed(lambda: next(runs), lambda run: False)
    assert next(runs) == 3 + TRIES


def test_nothing_excuses_it_where_the_machine_went_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stalls, "Witness", Still)
    monkeypatch.setattr(Still, "kept", LONG - 1)
    runs = iter(range(TRIES))
    assert undisturbed(lambda: next(runs), lambda run: False) == 0
    assert next(runs) == 1
