"""Report of a study: its numbers agree with its rows, and its page is self-contained.

Both exist for studies with few runs too.
"""

import base64
import json
import math
import re
from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
import pytest
from studies import make_small_plan, run_plan

from rcmservo.cli.terminal import open_console
from rcmservo.interfaces import Floats
from rcmservo.study.execution import manifest
from rcmservo.study.execution.store import RUNS_FILE, read_runs
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.report import report
from rcmservo.study.report.maps import MAP_AXES, ConvergenceMap, make_map
from rcmservo.study.report.statistics import Interval
from rcmservo.study.report.summary import Group
from rcmservo.study.report.text import build_result_table, describe_comparison

PA: Any = pa
HTML_NAME = "<b>&amp;"
COUNT = 30
INFINITE = 1e400
NOT_A_NUMBER = re.compile(r"(?<![a-z])(nan|inf)(?![a-z])")


class ReportedStudy:
    """Study with its folder, rows, numbers and page."""

    def __init__(self, folder: Path, plan: StudyPlan, table: Any = None) -> None:
        self.folder, self.plan = folder, plan
        rows = run_plan(plan, folder).gather() if table is None else table
        about = {"command": "rcmservo study", "replay": "rcmservo study --out X --replay"}
        self.summary = report.write_report(folder, plan, rows, about, page=True)
        self.rows = rows.to_pylist()
        self.page = (folder / report.REPORT_FILE).read_text("utf-8")
        self.parsed = ParsedPage(self.page)
        text = (folder / report.SUMMARY_FILE).read_text("utf-8")
        self.numbers = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} in JSON"))

    def of(self, method: str, noise: float) -> list[dict[str, Any]]:
        """Return the rows of a method with this noise, sorted by scene and repetition."""
        rows = [r for r in self.rows if (r["method"], r["noise_px"]) == (method, noise)]
        return sorted(rows, key=lambda row: (row["seed"], row["repetition"]))


class ParsedPage(HTMLParser):
    """Tags, links and text of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [str(v) for k, v in attrs if k in ("src", "href", "srcset", "action", "data")]

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> ReportedStudy:
    """Study of three methods, one with HTML in its name, two conditions and two repetitions."""
    plan = make_small_plan(
        methods=("dlt", "projection", HTML_NAME),
        method={HTML_NAME: {"estimator": "dlt", "controller": {"gain": 2.0}}},
        noise=(0.3, 2.0),
        count=COUNT,
        repetitions=2,
        duration=3.5,
    )
    return ReportedStudy(tmp_path_factory.mktemp("study"), plan)


def column(rows: Iterable[dict[str, Any]], name: str) -> Floats:
    return np.array([np.inf if row[name] is None else row[name] for row in rows], np.float64)


def expected_quantile(values: Floats, p: float) -> Any:
    """Return a quantile as the report defines it; None if it is infinite.

    For an integer number of values below, it is the mean of two finite neighbours.
    """
    ordered, rank = np.sort(values), Fraction(str(p)) * len(values)
    below, above = ordered[math.ceil(rank) - 1], ordered[math.floor(rank)]
    value = 0.5 * (below + above) if np.isfinite(above) else below
    return pytest.approx(value) if np.isfinite(value) else None


@pytest.mark.parametrize("noise", [0.3, 2.0])
@pytest.mark.parametrize("method", ["dlt", "projection", HTML_NAME])
def test_the_numbers_of_a_summary_agree_with_the_rows(
    study: ReportedStudy, method: str, noise: float
) -> None:
    rows, name = study.of(method, noise), f"random, {noise:g} px"
    summary = next(
        entry
        for entry in study.numbers["methods"]
        if (entry["method"], entry["condition"]) == (method, name)
    )
    assert summary["runs"] == len(rows) == 2 * COUNT
    arrived = column(rows, "pose_error_mm") <= 1.0
    assert summary["success"]["value"] == np.mean(arrived)
    p, z, n = np.mean(arrived), 1.959964, len(rows)  # independent form of Wilson's interval
    half = z * np.sqrt(p * (1 - p) / n + (z / n / 2) ** 2)
    ends = [(p + z**2 / n / 2 + sign * half) / (1 + z**2 / n) for sign in (-1, 1)]
    assert [summary["success"]["low"], summary["success"]["high"]] == pytest.approx(ends, abs=1e-6)
    for key, values, p in (
        ("time_median_s", column(rows, "time_to_1mm_s"), 0.5),
        ("time_95_s", column(rows, "time_to_1mm_s"), 0.95),
        ("pose_median_mm", column(rows, "pose_error_mm"), 0.5),
        ("pose_95_mm", column(rows, "pose_error_mm"), 0.95),
        ("unnoticed_99_mm", column(rows, "unnoticed_mm"), 0.99),
    ):
        assert summary[key]["value"] == expected_quantile(values, p), key
    ratios = (column(rows, "pose_error_mm") / column(rows, "bound_mm"))[arrived]
    assert summary["ratio_rms"]["value"] == pytest.approx(np.sqrt(np.mean(ratios**2)))
    assert summary["unnoticed_worst_mm"] == max(column(rows, "unnoticed_mm"))
    names = [row["stop"] for row in rows if row["stop"]]
    assert summary["stops"] == {cause: names.count(cause) for cause in names}


@pytest.mark.parametrize("noise", [0.3, 2.0])
def test_methods_are_compared_in_the_same_scene_with_the_same_noise(
    study: ReportedStudy, noise: float
) -> None:
    """Pairs shifted by one scene have another median."""
    one, other = study.of("projection", noise), study.of("dlt", noise)
    comparison = next(
        c
        for c in study.numbers["comparisons"]
        if c["method"] == "projection" and c["condition"].endswith(f" {noise:g} px")
    )
    assert comparison["beside"] == "dlt" and comparison["pairs"] == 2 * COUNT
    success = [column(rows, "pose_error_mm") <= 1.0 for rows in (one, other)]
    assert comparison["success"]["value"] == pytest.approx(
        np.mean(success[0]) - np.mean(success[1])
    )
    times = [column(rows, "time_to_1mm_s") for rows in (one, other)]
    known = np.isfinite(times[0]) | np.isfinite(times[1])
    difference = times[0][known] - times[1][known]
    assert comparison["time_s"]["value"] == expected_quantile(difference, 0.5)
    poses, both = [column(rows, "pose_error_mm") for rows in (one, other)], success[0] & success[1]
    assert comparison["pose_mm"]["value"] == expected_quantile((poses[0] - poses[1])[both], 0.5)
    shifted = (poses[0] - np.roll(poses[1], 1))[both]
    assert comparison["pose_mm"]["value"] != expected_quantile(shifted, 0.5)


def test_the_page_has_no_scripts_and_no_links_to_a_network(study: ReportedStudy) -> None:
    assert study.parsed.links and all(link.startswith("data:") for link in study.parsed.links)
    assert not re.search(r"https?:|//|url\(|@import", study.page.replace("</", ""))
    assert not {"script", "iframe", "link", "object"} & set(study.parsed.tags)


def test_the_page_has_every_method_and_condition_and_a_figure_per_condition(
    study: ReportedStudy,
) -> None:
    figures = [base64.b64decode(link.partition(",")[2]) for link in study.parsed.links]
    assert len(figures) == 2 and figures[0] != figures[1]
    for figure in figures:
        ElementTree.fromstring(figure)
        assert all(link.startswith(b"#") for link in re.findall(rb'href="([^"]*)"', figure))
        assert b"<!-- dlt -->" in figure and b"<!-- projection -->" in figure
    for text in ("random, 0.3 px", "random, 2 px", "dlt", "projection", HTML_NAME, "compiled"):
        assert text in study.parsed.text
    for method in ("dlt", "projection", HTML_NAME):
        assert study.parsed.text.count(f"Settings of {method}") == 1
    assert study.parsed.text.count("Convergence by scene") == 2


def test_names_are_escaped_in_the_page(study: ReportedStudy) -> None:
    assert "b" not in study.parsed.tags
    assert HTML_NAME in study.parsed.text and HTML_NAME not in study.page


def test_the_page_lists_the_worst_runs_with_the_row_that_repeats_them(study: ReportedStudy) -> None:
    """Rows count across conditions and repetitions."""
    cases = [
        int(case) for case in re.findall(r"rcmservo study --out X --replay (\d+)<", study.page)
    ]
    recorded, expected = manifest.read_manifest(study.folder), []
    for noise in (0.3, 2.0):
        for method in ("dlt", "projection", HTML_NAME):
            indices = [
                i
                for i, r in enumerate(study.rows)
                if (r["method"], r["noise_px"]) == (method, noise)
            ]
            errors = column(study.rows, "pose_error_mm")
            expected += sorted(indices, key=lambda i: -errors[i])[: report.WORST_RUN_COUNT]
    assert cases == expected and recorded is not None
    assert {study.rows[case]["repetition"] for case in cases} == {0, 1}
    for case in cases:
        (cell, seed), row = recorded.find_run(case), study.rows[case]
        noise = cell.tables["camera"]["point_noise"]
        assert (cell.method, seed, cell.repetition, noise) == tuple(
            row[name] for name in ("method", "seed", "repetition", "noise_px")
        )


def test_the_terminal_wraps_long_names_without_cropping(
    study: ReportedStudy, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    open_console().print(build_result_table(study.summary.summaries))
    output = capsys.readouterr().out
    assert "…" not in output and max(map(len, output.splitlines())) <= 80
    cells = [line.split("│")[1].strip() for line in output.splitlines() if line.startswith("│")]
    assert "".join(cells).count("projection") == 2


def test_an_infinite_difference_of_times_is_described_in_words() -> None:
    never, unknown = Interval(np.inf, np.inf, np.inf), Interval(np.nan, np.nan, np.nan)
    success = Interval(-1.0, -1.0, -0.6)
    later = report.PairedComparison("a", "b", "random", 9, success, never, unknown)
    assert describe_comparison(later) == (
        "a compared with b, random, 9 pairs: success -100.0 (-100.0 to -60.0) % points, "
        "mostly only b reaches 1 mm, error –"
    )
    equal = replace(later, time_s=Interval(0.0, 0.0, 0.0), pose_mm=Interval(0.0, 0.0, 0.0))
    assert describe_comparison(equal).endswith("to 1 mm +0.00 s, error +0.000 mm")
    sooner = replace(later, time_s=Interval(-np.inf, -np.inf, -0.5))
    assert "mostly only a reaches 1 mm" in describe_comparison(sooner)


def make_group(success: list[bool], **columns: Any) -> Group:
    """Return a group of runs with these columns."""
    defaults = {name: np.arange(1.0, len(success) + 1.0) for axes in MAP_AXES for name, _ in axes}
    table = PA.table({"success": success, **defaults, **columns})
    return Group("m", "random", [0], table)


def list_cells(convergence_map: ConvergenceMap) -> list[tuple[int, Interval]]:
    return [cell for row in convergence_map.cells for cell in row if cell is not None]


def assign_to_bins(values: Floats, labels: list[str]) -> list[Floats]:
    """Return, for each bin, which values are in it; the edges are NumPy's quantiles."""
    edges = np.quantile(values, np.linspace(0.0, 1.0, len(labels) + 1))
    inside = [(low <= values) & (values < high) for low, high in pairwise(edges)]
    inside[-1] |= values >= edges[-1]
    return inside


def test_the_cells_of_a_map_hold_all_runs_with_their_success_rates() -> None:
    random = np.random.default_rng(0)
    down = random.permutation(400.0 + np.arange(400))
    across = random.permutation(1.0 * np.arange(400))
    success = random.random(400) < across / 400.0
    convergence_map = make_map(
        make_group(success.tolist(), condition=down, start_error_mm=across), *MAP_AXES[0]
    )
    assert (
        len(convergence_map.rows) == len(convergence_map.columns) == 5
        and convergence_map.rows[0] == "400 to 480"
    )
    for row, in_row in zip(
        convergence_map.cells, assign_to_bins(down, convergence_map.rows), strict=True
    ):
        for cell, in_column in zip(
            row, assign_to_bins(across, convergence_map.columns), strict=True
        ):
            cell_success = success[in_row & in_column]
            assert cell is not None and cell[0] == len(cell_success)
            assert cell[1].value == cell_success.mean() and cell[1].low < cell[1].high
    assert sum(count for count, _ in list_cells(convergence_map)) == 400


@pytest.mark.parametrize(
    ("conditions", "rows"),
    [
        ([7.0], ["7"]),
        ([7.0] * 300, ["7"]),
        ([INFINITE] * 300, ["∞"]),
        ([7.0] * 299 + [INFINITE], ["7", "∞"]),
        ([*range(1, 300), INFINITE], None),
    ],
)
def test_a_map_of_few_equal_or_infinite_values_holds_all_runs(
    conditions: list[float], rows: list[str] | None
) -> None:
    values = np.array(conditions, np.float64)
    convergence_map = make_map(make_group([True] * len(values), condition=values), *MAP_AXES[0])
    assert sum(count for count, _ in list_cells(convergence_map)) == len(values)
    assert all(
        "inf" not in text and "nan" not in text
        for text in (*convergence_map.rows, *convergence_map.columns)
    )
    if rows is not None:
        assert convergence_map.rows == rows
    else:
        assert convergence_map.rows[-2:] == ["239 to 299", "∞"] and len(convergence_map.rows) == 6
        assert sum(cell[0] for cell in convergence_map.cells[-1] if cell) == 1


def test_a_study_of_one_scene_has_a_report_without_differences(tmp_path: Path) -> None:
    study = ReportedStudy(tmp_path, make_small_plan(count=1, duration=6.0))
    first = study.numbers["methods"][0]
    assert first["success"]["value"] == 1.0 and first["pose_median_mm"]["high"] is None
    assert study.numbers["comparisons"][0]["pose_mm"]["low"] is None
    assert "worse" not in study.parsed.words and "better" not in study.parsed.words
    assert not NOT_A_NUMBER.search(study.parsed.text)
    assert study.parsed.text.count("no difference found") == 3
    assert "Convergence by scene" not in study.parsed.text  # a single cell repeats the success rate


def test_a_study_without_success_has_a_report(tmp_path: Path) -> None:
    study = ReportedStudy(tmp_path, make_small_plan(count=30, duration=1.2))
    for summary in study.numbers["methods"]:
        assert summary["success"]["value"] == 0.0 and summary["time_median_s"]["value"] is None
        assert summary["ratio_rms"] == {"value": None, "low": None, "high": None}
    assert "never" in study.parsed.words and "–" in study.parsed.words
    assert not NOT_A_NUMBER.search(study.parsed.text)


def test_an_unknown_bound_is_a_dash_in_the_page(tmp_path: Path) -> None:
    """The bound is unknown for rendered frames."""
    plan = make_small_plan(count=20, methods=("dlt",), duration=4.0)
    rows = run_plan(plan, tmp_path / "a").gather()
    for name in ("bound_mm", "noise_px"):
        index = rows.schema.get_field_index(name)
        empty = PA.array([None] * rows.num_rows, PA.float64())
        rows = rows.set_column(index, rows.schema.field(name), empty)
    study = ReportedStudy(tmp_path / "a", plan, rows)
    summary = study.numbers["methods"][0]
    assert summary["success"]["value"] > 0.5 and summary["ratio_median"]["value"] is None
    assert study.parsed.words.count("–") == 2


def test_without_noise_the_ratio_to_the_bound_is_unknown(tmp_path: Path) -> None:
    study = ReportedStudy(
        tmp_path, make_small_plan(count=20, methods=("dlt",), duration=4.0, noise=(0.0,))
    )
    summary = study.numbers["methods"][0]
    assert {row["bound_mm"] for row in study.rows} == {0.0} and summary["success"]["value"] > 0.5
    assert summary["ratio_rms"]["value"] is None and study.parsed.words.count("–") == 2


def test_the_meanings_of_the_columns_are_in_the_file_and_on_the_page(study: ReportedStudy) -> None:
    table = read_runs(study.folder)
    meanings = {field.name: field.metadata[b"meaning"].decode() for field in table.schema}
    assert (
        len(meanings) == len(table.column_names) and (study.folder / RUNS_FILE).stat().st_size < 1e6
    )
    for name, meaning in meanings.items():
        assert name in study.parsed.text and meaning in study.parsed.text


def test_cumulative_curves_start_at_zero_and_end_at_the_fraction_of_finite_values() -> None:
    """A curve of one run is a visible step, not a single point."""
    for values, last in (([3.0], 1.0), ([1.0, 2.0, np.inf, np.inf], 0.5), ([np.inf], 0.0)):
        group = SimpleNamespace(
            method="m", first_within=np.array(values), column=lambda name: np.array([0.5])
        )
        times, poses = report.make_figure([group], 15.0).panels  # pyright: ignore
        curve = times.curves[0]
        assert (curve.x[0], curve.y[0], curve.x[-1], curve.y[-1]) == (0.0, 0.0, 15.0, last)
        assert poses.curves[0].y == [0.0, 1.0] and poses.curves[0].x == [0.5, 0.5]
    many = np.random.default_rng(0).uniform(0.0, 15.0, 10_000)
    group = SimpleNamespace(method="m", first_within=many, column=lambda name: many)
    for panel in report.make_figure([group], 15.0).panels:  # pyright: ignore
        x, y = np.array(panel.curves[0].x), np.array(panel.curves[0].y)
        assert len(x) <= 500 and y[-1] == 1.0 and np.abs(y - x / 15.0).max() < 0.02
