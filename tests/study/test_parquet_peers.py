"""The rows of a study open in what others read tables with: pandas, Polars and DuckDB find the same
columns, of the right kinds, with the same values and what they mean.
"""

import importlib
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from studies import made, small

from conftest import ROOT
from peers import peer
from rcmservo.study.execution.store import RUNS
from rcmservo.study.row import MEANINGS, StudyRow

PEERS = ROOT / ".peers"
NAMES = [f.name for f in fields(StudyRow)]
HINTS = get_type_hints(StudyRow)
KINDS = [str(HINTS[name]).removeprefix("<class '").split("'")[0].split(" |")[0] for name in NAMES]
"""str, int, float or bool, of every column."""


def of(name: str) -> Callable[..., Any]:
    return peer(name, (PEERS / name).is_dir(), "make peers")


def theirs(name: str) -> Any:
    """Their module; NumPy and Arrow are ours."""
    if str(PEERS) not in sys.path:
        sys.path.append(str(PEERS))
    return importlib.import_module(name)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, Any]]]:
    """The file, and what is in it: runs that arrived, and some that never did."""
    folder = tmp_path_factory.mktemp("study")
    rows = made(small(count=4, duration=2.1), folder).gather().to_pylist()
    assert {row["time_to_1mm_s"] is None for row in rows} == {True, False}
    return folder / RUNS, rows


@of("pandas")
def test_pandas_reads_rows(study: tuple[Path, list[dict[str, Any]]]) -> None:
    path, rows = study
    table = theirs("pandas").read_parquet(path)
    assert list(table.columns) == NAMES and len(table) == 8
    letters = {"str": "OU", "int": "i", "float": "f", "bool": "b"}
    for name, kind in zip(NAMES, KINDS, strict=True):
        assert table[name].dtype.kind in letters[kind], name
        unknown = [row[name] is None for row in rows]
        assert table[name].isna().tolist() == unknown
        known = [row[name] for row in rows if row[name] is not None]
        assert table[name].dropna().tolist() == known
    means = table.groupby("method")["pose_error_mm"].mean()
    assert means["dlt"] == pytest.approx(sum(row["pose_error_mm"] for row in rows[:4]) / 4.0)


@of("polars")
def test_polars_reads_rows(study: tuple[Path, list[dict[str, Any]]]) -> None:
    path, rows = study
    polars = theirs("polars")
    table = polars.read_parquet(path)
    names = {"str": "String", "int": "Int64", "float": "Float64", "bool": "Boolean"}
    found = {name: str(kind) for name, kind in table.schema.items()}
    assert found == {name: names[kind] for name, kind in zip(NAMES, KINDS, strict=True)}
    assert table.to_dicts() == rows
    assert MEANINGS.items() <= polars.read_parquet_metadata(path).items()


@of("duckdb")
def test_duckdb_reads_rows(study: tuple[Path, list[dict[str, Any]]]) -> None:
    path, rows = study
    with theirs("duckdb").connect() as data:
        told = data.execute(f"DESCRIBE SELECT * FROM '{path}'").fetchall()
        names = {"str": "VARCHAR", "int": "BIGINT", "float": "DOUBLE", "bool": "BOOLEAN"}
        kinds = [names[kind] for kind in KINDS]
        assert [one[:2] for one in told] == list(zip(NAMES, kinds, strict=True))
        values = data.execute(f"SELECT * FROM '{path}'").fetchall()
        assert [dict(zip(NAMES, one, strict=True)) for one in values] == rows
        meant = data.execute(f"SELECT key, value FROM parquet_kv_metadata('{path}')").fetchall()
    known = {key.decode(): value.decode("utf-8", "replace") for key, value in meant}
    assert MEANINGS.items() <= known.items()
