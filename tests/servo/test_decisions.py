"""The servo decides what it decided when these runs with faults were kept. Where a decision changes
on purpose: `python benchmarks/decisions.py tests/data/decisions --anew`."""

from pathlib import Path

import numpy as np
import pytest
from decisions import ROUNDING, compared

from conftest import ROOT

RUNS = sorted((ROOT / "tests/data/decisions").glob("*.npz"))


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_phases_causes_and_commands_are_those_of_the_run_that_was_kept(path: Path) -> None:
    run = compared(path)
    assert run.ticks > 0
    assert run.differs is None, f"from tick {run.differs} on"
    assert run.worst <= ROUNDING


def test_the_kept_runs_hold_many_causes() -> None:
    causes = {cause for path in RUNS for cause in np.load(path)["words"][:, 3]}
    assert len(RUNS) >= 5 and len(causes) >= 10
