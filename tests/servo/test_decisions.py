"""The servo repeats the decisions of recorded runs with faults.

After an intended change of a decision, rerun `python benchmarks/decisions.py tests/data/decisions
--anew` and record_loops.py.
"""

from pathlib import Path

import numpy as np
import packed_table
import pytest
from decisions import ROUNDING, compared, read
from hypothesis import given
from hypothesis import strategies as st
from packed_table import LOST, STEPS

from conftest import ROOT
from rcmservo.config.class_registry import ESTIMATORS

RUNS = sorted((ROOT / "tests/data/decisions").glob("*.npz"))
LOOPS = sorted((ROOT / "tests/data/loops").glob("*.npz.xz"))
"""Recorded loops, of every estimator in turn."""
QUICK, SLOW = LOOPS[: len(ESTIMATORS)], LOOPS[len(ESTIMATORS) :]


@pytest.mark.parametrize(
    "path",
    [*RUNS, *QUICK, *(pytest.param(path, marks=pytest.mark.slow) for path in SLOW)],
    ids=lambda path: path.name.partition(".")[0],
)
def test_phases_causes_and_commands_equal_those_of_the_recorded_run(path: Path) -> None:
    run = compared(path)
    assert run.ticks > 0
    assert run.differs is None, f"from tick {run.differs} on"
    assert run.worst <= ROUNDING


def test_the_recorded_runs_contain_many_causes() -> None:
    causes = {cause for path in RUNS for cause in np.load(path)["words"][:, 3]}
    assert len(RUNS) >= 5 and len(causes) >= 10


def test_the_recorded_loops_contain_every_estimator_and_many_causes() -> None:
    tables = [read(path) for path in LOOPS]
    assert {str(table["estimator"]) for table in tables} == {*ESTIMATORS}
    assert len({cause for table in tables for cause in table["words"][:, 3]}) >= 20
    assert np.mean([np.isfinite(table["reals"][:, 13:]).mean() for table in tables]) > 0.5
    assert len(LOOPS) == 100 and sum(path.stat().st_size for path in LOOPS) < 4_000_000


@given(st.integers(1, 20), st.integers(0))
def test_a_packed_table_is_restored_exactly(
    tmp_path_factory: pytest.TempPathFactory, ticks: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    whole = random.integers(-(2**30), 2**30, (ticks, len(STEPS)))
    steps = np.where(random.random(whole.shape) < 0.1, np.nan, whole / STEPS)
    rates = random.normal(size=(ticks, 3))
    applied = np.where(random.random((ticks, 1)) < 0.5, packed_table.before(rates), rates)
    table = {
        "integers": random.integers(-(2**40), 2**40, (ticks, 5)),
        "reals": np.hstack([steps[:, :3], applied, steps[:, 3:]]),
        "rates": rates,
        "words": random.choice(["HOLD", "SERVO", "NONE"], (ticks, 4)),
        "estimator": np.array("dlt"),
    }
    packed_table.write(path := tmp_path_factory.mktemp("table") / "table.npz.xz", table)
    restored = packed_table.read(path)
    assert restored.keys() == table.keys() and LOST not in whole
    for name, values in table.items():
        np.testing.assert_array_equal(restored[name], values)
        assert restored[name].dtype == values.dtype
