"""Rows of a study in pandas, Polars and DuckDB: the same columns, types, values and meanings."""

import importlib
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from studies import make_small_plan, run_plan

import rcmservo as rs
from conftest import ROOT
from peers import mark_peer
from rcmservo.study.execution.store import RUNS_FILE
from rcmservo.study.row import COLUMN_MEANINGS, StudyRow

PEERS = ROOT / ".peers"
NAMES = [f.name for f in fields(StudyRow)]
HINTS = get_type_hints(StudyRow)
KINDS = [str(HINTS[name]).removeprefix("<class '").split("'")[0].split(" |")[0] for name in NAMES]
"""Name of the type of every column: str, int, float or bool."""


def requires(name: str) -> Callable[..., Any]:
    return mark_peer(name, (PEERS / name).is_dir(), "make peers")


def import_reader(name: str) -> Any:
    """Import a reader from `.peers`, with NumPy and Arrow of this environment."""
    if str(PEERS) not in sys.path:
        sys.path.append(str(PEERS))
    return importlib.import_module(name)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, Any]]]:
    """Path and rows of a study in which some runs arrived and some did not."""
    folder = tmp_path_factory.mktemp("study")
    rows = run_plan(make_small_plan(count=4, duration=2.1), folder).gather().to_pylist()
    assert {row["time_to_1mm_s"] is None for row in rows} == {True, False}
    return folder / RUNS_FILE, rows


@requires("pandas")
def test_pandas_reads_rows(study: tuple[Path, list[dict[str, Any]]]) -> None:
    path, rows = study
    table = import_reader("pandas").read_parquet(path)
    assert list(table.columns) == NAMES and len(table) == 8
    letters = {"str": "OU", "int": "i", "float": "f", "bool": "b"}
    for name, kind in zip(NAMES, KINDS, strict=True):
        assert table[name].dtype.kind in letters[kind], name
        is_none = [row[name] is None for row in rows]
        assert table[name].isna().tolist() == is_none
        known = [row[name] for row in rows if row[name] is not None]
        assert table[name].dropna().tolist() == known
    means = table.groupby("method")["pose_error_mm"].mean()
    assert means["dlt"] == pytest.approx(sum(row["pose_error_mm"] for row in rows[:4]) / 4.0)


@requires("pandas")
def test_a_comparison_converts_to_pandas() -> None:
    pandas = import_reader("pandas")
    compared = rs.compare({"dlt": "dlt"}, scenes=2, duration=2.1, workers=1)
    table = compared.to_pandas()
    assert isinstance(table, pandas.DataFrame) and list(table.columns) == NAMES
    errors = [row.pose_error_mm for row in compared.rows]
    assert table["seed"].tolist() == [0, 1] and table["pose_error_mm"].tolist() == errors


@requires("polars")
def test_polars_reads_rows(study: tuple[Path, list[dict[str, Any]]]) -> None:
    path, rows = study
    polars = import_reader("polars")
    table = polars.read_parquet(path)
    names = {"str": "String", "int": "Int64", "float": "Float64", "bool": "Boolean"}
    column_types = {name: str(kind) for name, kind in table.schema.items()}
    assert column_types == {name: names[kind] for name, kind in zip(NAMES, KINDS, strict=True)}
    assert table.to_dicts() == rows
    assert COLUMN_MEANINGS.items() <= polars.read_parquet_metadata(path).items()


@requires("duckdb")
def test_duckdb_reads_rows(study: tuple[Path, list[dict[str, Any]]]) -> None:
    path, rows = study
    with import_reader("duckdb").connect() as data:
        described = data.execute(f"DESCRIBE SELECT * FROM '{path}'").fetchall()
        names = {"str": "VARCHAR", "int": "BIGINT", "float": "DOUBLE", "bool": "BOOLEAN"}
        kinds = [names[kind] for kind in KINDS]
        assert [column[:2] for column in described] == list(zip(NAMES, kinds, strict=True))
        values = data.execute(f"SELECT * FROM '{path}'").fetchall()
        assert [dict(zip(NAMES, row, strict=True)) for row in values] == rows
        metadata = data.execute(f"SELECT key, value FROM parquet_kv_metadata('{path}')").fetchall()
    known = {key.decode(): value.decode("utf-8", "replace") for key, value in metadata}
    assert COLUMN_MEANINGS.items() <= known.items()
