"""The servo decides what it decided before it was rebuilt: runs of version 0.1.0 with faults."""

from pathlib import Path

import pytest
from decisions import ROUNDING, compared

from conftest import ROOT

RUNS = sorted((ROOT / "tests/data/v0.1.0/decisions").glob("*.npz"))


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_phases_causes_and_commands_are_those_of_the_run_that_was_kept(path: Path) -> None:
    run = compared(path)
    assert run.ticks > 0
    assert run.differs is None, f"from tick {run.differs} on"
    assert run.worst <= ROUNDING


def test_the_kept_runs_hold_many_causes() -> None:
    assert len(RUNS) >= 5
