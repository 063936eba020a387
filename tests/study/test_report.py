"""What a study tells: its numbers are those of its rows, its page needs nothing but itself, and
neither ends where there is little to tell.
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
from studies import made, small

from rcmservo.cli.studies.study_report import beside, results
from rcmservo.cli.terminal import console
from rcmservo.interfaces import Floats
from rcmservo.study.execution import manifest
from rcmservo.study.execution.store import RUNS, runs_in
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.report import report
from rcmservo.study.report.maps import AXES, Map, map_of
from rcmservo.study.report.statistics import Interval
from rcmservo.study.report.summary import Group

PA: Any = pa
ODD = "<b>&amp;"
COUNT = 60
INFINITE = 1e400
NO_NUMBER = re.compile(r"(?<![a-z])(nan|inf)(?![a-z])")


class Study:
    """A study that was told: its folder, rows, numbers and page."""

    def __init__(self, folder: Path, plan: StudyPlan, table: Any = None) -> None:
        self.folder, self.plan = folder, plan
        rows = made(plan, folder).gather() if table is None else table
        about = {"command": "rcmservo study", "replay": "rcmservo study --out X --replay"}
        self.told = report.write(folder, plan, rows, about, page=True)
        self.rows = rows.to_pylist()
        self.page = (folder / report.REPORT).read_text("utf-8")
        self.seen = Seen(self.page)
        text = (folder / report.SUMMARY).read_text("utf-8")
        self.numbers = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} in JSON"))

    def of(self, method: str, noise: float) -> list[dict[str, Any]]:
        """The rows of a method with this noise, by what their scenes and noises are."""
        chosen = [r for r in self.rows if (r["method"], r["noise_px"]) == (method, noise)]
        return sorted(chosen, key=lambda row: (row["seed"], row["repetition"]))


class Seen(HTMLParser):
    """What a browser finds in a page."""

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
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Three methods, one with a name of HTML, two conditions, two repetitions."""
    plan = small(
        methods=("dlt", "projection", ODD),
        method={ODD: {"estimator": "dlt", "controller": {"gain": 2.0}}},
        noise=(0.3, 2.0),
        count=COUNT,
        repetitions=2,
        duration=3.5,
    )
    return Study(tmp_path_factory.mktemp("study"), plan)


def column(rows: Iterable[dict[str, Any]], name: str) -> Floats:
    return np.array([np.inf if row[name] is None else row[name] for row in rows], np.float64)


def at(values: Floats, p: float) -> Any:
    """A quantile as the report has it: the value up to which there are so many, half-way to the
    next one that came where they are whole; null beyond all that came.
    """
    ordered, many = np.sort(values), Fraction(str(p)) * len(values)
    below, above = ordered[math.ceil(many) - 1], ordered[math.floor(many)]
    found = 0.5 * (below + above) if np.isfinite(above) else below
    return pytest.approx(found) if np.isfinite(found) else None


@pytest.mark.parametrize("noise", [0.3, 2.0])
@pytest.mark.parametrize("method", ["dlt", "projection", ODD])
def test_the_numbers_of_a_summary_are_those_of_the_rows(
    study: Study, method: str, noise: float
) -> None:
    rows, name = study.of(method, noise), f"random, {noise:g} px"
    told = next(
        one
        for one in study.numbers["methods"]
        if (one["method"], one["condition"]) == (method, name)
    )
    assert told["runs"] == len(rows) == 2 * COUNT
    arrived = column(rows, "pose_error_mm") <= 1.0
    assert told["success"]["value"] == np.mean(arrived)
    p, z, n = np.mean(arrived), 1.959964, len(rows)  # Wilson's interval, written down once more
    half = z * np.sqrt(p * (1 - p) / n + (z / n / 2) ** 2)
    ends = [(p + z**2 / n / 2 + sign * half) / (1 + z**2 / n) for sign in (-1, 1)]
    assert [told["success"]["low"], told["success"]["high"]] == pytest.approx(ends, abs=1e-6)
    for key, values, share in (
        ("time_median_s", column(rows, "time_to_1mm_s"), 0.5),
        ("time_95_s", column(rows, "time_to_1mm_s"), 0.95),
        ("pose_median_mm", column(rows, "pose_error_mm"), 0.5),
        ("pose_95_mm", column(rows, "pose_error_mm"), 0.95),
        ("unnoticed_99_mm", column(rows, "unnoticed_mm"), 0.99),
    ):
        assert told[key]["value"] == at(values, share), key
    ratios = (column(rows, "pose_error_mm") / column(rows, "bound_mm"))[arrived]
    assert told["ratio_rms"]["value"] == pytest.approx(np.sqrt(np.mean(ratios**2)))
    assert told["unnoticed_worst_mm"] == max(column(rows, "unnoticed_mm"))
    names = [row["stop"] for row in rows if row["stop"]]
    assert told["stops"] == {one: names.count(one) for one in names}


@pytest.mark.parametrize("noise", [0.3, 2.0])
def test_methods_are_compared_in_the_same_scene_with_the_same_noise(
    study: Study, noise: float
) -> None:
    """Pairs that are out of step by one have another median."""
    one, other = study.of("projection", noise), study.of("dlt", noise)
    told = next(
        c
        for c in study.numbers["comparisons"]
        if c["method"] == "projection" and c["condition"].endswith(f" {noise:g} px")
    )
    assert told["beside"] == "dlt" and told["pairs"] == 2 * COUNT
    success = [column(rows, "pose_error_mm") <= 1.0 for rows in (one, other)]
    assert told["success"]["value"] == pytest.approx(np.mean(success[0]) - np.mean(success[1]))
    times = [column(rows, "time_to_1mm_s") for rows in (one, other)]
    known = np.isfinite(times[0]) | np.isfinite(times[1])
    assert told["time_s"]["value"] == at(times[0][known] - times[1][known], 0.5)
    poses, both = [column(rows, "pose_error_mm") for rows in (one, other)], success[0] & success[1]
    assert told["pose_mm"]["value"] == at((poses[0] - poses[1])[both], 0.5)
    shifted = (poses[0] - np.roll(poses[1], 1))[both]
    assert told["pose_mm"]["value"] != at(shifted, 0.5)


def test_the_page_opens_without_a_network_and_runs_nothing(study: Study) -> None:
    assert study.seen.links and all(link.startswith("data:") for link in study.seen.links)
    assert not re.search(r"https?:|//|url\(|@import", study.page.replace("</", ""))
    assert not {"script", "iframe", "link", "object"} & set(study.seen.tags)


def test_the_page_has_every_method_every_condition_and_a_figure_of_each(study: Study) -> None:
    figures = [base64.b64decode(link.partition(",")[2]) for link in study.seen.links]
    assert len(figures) == 2 and figures[0] != figures[1]
    for figure in figures:
        ElementTree.fromstring(figure)
        assert all(one.startswith(b"#") for one in re.findall(rb'href="([^"]*)"', figure))
        assert b"<!-- dlt -->" in figure and b"<!-- projection -->" in figure
    for words in ("random, 0.3 px", "random, 2 px", "dlt", "projection", ODD, "compiled"):
        assert words in study.seen.text
    for method in ("dlt", "projection", ODD):
        assert study.seen.text.count(f"Settings of {method}") == 1
    assert study.seen.text.count("Where it converges") == 2


def test_a_name_is_never_taken_for_html(study: Study) -> None:
    assert "b" not in study.seen.tags
    assert ODD in study.seen.text and ODD not in study.page


def test_the_worst_runs_are_the_worst_and_their_command_makes_them_again(study: Study) -> None:
    """By their rows, also in a second condition and of a second repetition."""
    cases = [
        int(case) for case in re.findall(r"rcmservo study --out X --replay (\d+)<", study.page)
    ]
    made_of, expected = manifest.read(study.folder), []
    for noise in (0.3, 2.0):
        for method in ("dlt", "projection", ODD):
            own = [
                i
                for i, r in enumerate(study.rows)
                if (r["method"], r["noise_px"]) == (method, noise)
            ]
            errors = column(study.rows, "pose_error_mm")
            expected += sorted(own, key=lambda i: -errors[i])[: report.WORST]
    assert cases == expected and made_of is not None
    assert {study.rows[case]["repetition"] for case in cases} == {0, 1}
    for case in cases:
        (cell, seed), row = made_of.run_of(case), study.rows[case]
        noise = cell.tables["camera"]["point_noise"]
        assert (cell.method, seed, cell.repetition, noise) == tuple(
            row[name] for name in ("method", "seed", "repetition", "noise_px")
        )


def test_the_terminal_folds_long_words_and_crops_none(
    study: Study, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    console().print(results(study.told.summaries))
    said = capsys.readouterr().out
    assert "…" not in said and max(map(len, said.splitlines())) <= 80
    cells = [line.split("│")[1].strip() for line in said.splitlines() if line.startswith("│")]
    assert "".join(cells).count("projection") == 2


def test_what_only_one_of_two_does_is_said_in_words() -> None:
    never, some = Interval(np.inf, np.inf, np.inf), Interval(np.nan, np.nan, np.nan)
    one = report.PairedComparison("a", "b", "random", 9, Interval(-1.0, -1.0, -0.6), never, some)
    assert beside(one) == (
        "a compared with b, random, 9 pairs: success -100.0 (-100.0 to -60.0) % points, "
        "mostly only b reaches 1 mm, error –"
    )
    alike = replace(one, time_s=Interval(0.0, 0.0, 0.0), pose_mm=Interval(0.0, 0.0, 0.0))
    assert beside(alike).endswith("to 1 mm +0.00 s, error +0.000 mm")
    sooner = replace(one, time_s=Interval(-np.inf, -np.inf, -0.5))
    assert "mostly only a reaches 1 mm" in beside(sooner)


def group(success: list[bool], **columns: Any) -> Group:
    """A group of runs with these columns."""
    usual = {name: np.arange(1.0, len(success) + 1.0) for axes in AXES for name, _ in axes}
    table = PA.table({"success": success, **usual, **columns})
    return Group("m", "random", [0], table)


def all_of(one: Map) -> list[tuple[int, Interval]]:
    return [cell for row in one.cells for cell in row if cell is not None]


def brute(values: Floats, shown: list[str]) -> list[Floats]:
    """Which of the values each bin has: about as many each, the ends by NumPy's quantiles."""
    edges = np.quantile(values, np.linspace(0.0, 1.0, len(shown) + 1))
    inside = [(low <= values) & (values < high) for low, high in pairwise(edges)]
    inside[-1] |= values >= edges[-1]
    return inside


def test_the_cells_of_a_map_are_all_runs_and_their_shares_those_of_the_runs_in_them() -> None:
    random = np.random.default_rng(0)
    down, across = (
        random.permutation(400.0 + np.arange(400)),
        random.permutation(1.0 * np.arange(400)),
    )
    success = random.random(400) < across / 400.0
    one = map_of(group(success.tolist(), condition=down, start_error_mm=across), *AXES[0])
    assert len(one.rows) == len(one.columns) == 5 and one.rows[0] == "400 to 480"
    for row, below in zip(one.cells, brute(down, one.rows), strict=True):
        for cell, left in zip(row, brute(across, one.columns), strict=True):
            here = success[below & left]
            assert cell is not None and cell[0] == len(here)
            assert cell[1].value == here.mean() and cell[1].low < cell[1].high
    assert sum(count for count, _ in all_of(one)) == 400


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
def test_a_map_of_few_or_equal_or_infinite_values_still_has_all_runs(
    conditions: list[float], rows: list[str] | None
) -> None:
    values = np.array(conditions, np.float64)
    one = map_of(group([True] * len(values), condition=values), *AXES[0])
    assert sum(count for count, _ in all_of(one)) == len(values)
    assert all("inf" not in words and "nan" not in words for words in (*one.rows, *one.columns))
    if rows is not None:
        assert one.rows == rows
    else:
        assert one.rows[-2:] == ["239 to 299", "∞"] and len(one.rows) == 6
        assert sum(cell[0] for cell in one.cells[-1] if cell) == 1


def test_a_study_of_one_scene_is_told_and_tells_nothing_apart(tmp_path: Path) -> None:
    study = Study(tmp_path, small(count=1, duration=6.0))
    first = study.numbers["methods"][0]
    assert first["success"]["value"] == 1.0 and first["pose_median_mm"]["high"] is None
    assert study.numbers["comparisons"][0]["pose_mm"]["low"] is None
    assert "worse" not in study.seen.words and "better" not in study.seen.words
    assert not NO_NUMBER.search(study.seen.text)
    assert study.seen.text.count("not told apart") == 3
    assert "Where it converges" not in study.seen.text  # one cell would repeat the success rate


def test_a_study_without_any_success_is_told(tmp_path: Path) -> None:
    study = Study(tmp_path, small(count=30, duration=1.2))
    for one in study.numbers["methods"]:
        assert one["success"]["value"] == 0.0 and one["time_median_s"]["value"] is None
        assert one["ratio_rms"] == {"value": None, "low": None, "high": None}
    assert "never" in study.seen.words and "–" in study.seen.words
    assert not NO_NUMBER.search(study.seen.text)


def test_where_the_bound_is_not_known_the_page_has_a_dash(tmp_path: Path) -> None:
    """As of rendered frames: no number may be made of what is not known."""
    plan = small(count=20, methods=("dlt",), duration=4.0)
    rows = made(plan, tmp_path / "a").gather()
    for name in ("bound_mm", "noise_px"):
        place = rows.schema.get_field_index(name)
        empty = PA.array([None] * rows.num_rows, PA.float64())
        rows = rows.set_column(place, rows.schema.field(name), empty)
    study = Study(tmp_path / "a", plan, rows)
    one = study.numbers["methods"][0]
    assert one["success"]["value"] > 0.5 and one["ratio_median"]["value"] is None
    assert study.seen.words.count("–") == 2


def test_without_noise_there_is_no_bound_to_divide_by(tmp_path: Path) -> None:
    study = Study(tmp_path, small(count=20, methods=("dlt",), duration=4.0, noise=(0.0,)))
    one = study.numbers["methods"][0]
    assert {row["bound_mm"] for row in study.rows} == {0.0} and one["success"]["value"] > 0.5
    assert one["ratio_rms"]["value"] is None and study.seen.words.count("–") == 2


def test_the_rows_say_what_their_columns_mean_wherever_they_are(study: Study) -> None:
    table = runs_in(study.folder)
    meanings = {field.name: field.metadata[b"meaning"].decode() for field in table.schema}
    assert len(meanings) == len(table.column_names) and (study.folder / RUNS).stat().st_size < 1e6
    for name, meaning in meanings.items():
        assert name in study.seen.text and meaning in study.seen.text


def test_curves_of_shares_begin_at_none_and_end_at_what_came() -> None:
    """Also of one run, of which a line through its one point would not be seen."""
    for values, last in (([3.0], 1.0), ([1.0, 2.0, np.inf, np.inf], 0.5), ([np.inf], 0.0)):
        here = SimpleNamespace(
            method="m", first_within=np.array(values), column=lambda name: np.array([0.5])
        )
        times, poses = report._figure([here], 15.0).panels  # pyright: ignore
        one = times.curves[0]
        assert (one.x[0], one.y[0], one.x[-1], one.y[-1]) == (0.0, 0.0, 15.0, last)
        assert poses.curves[0].y == [0.0, 1.0] and poses.curves[0].x == [0.5, 0.5]
    many = np.random.default_rng(0).uniform(0.0, 15.0, 10_000)
    here = SimpleNamespace(method="m", first_within=many, column=lambda name: many)
    for panel in report._figure([here], 15.0).panels:  # pyright: ignore
        x, y = np.array(panel.curves[0].x), np.array(panel.curves[0].y)
        assert len(x) <= 500 and y[-1] == 1.0 and np.abs(y - x / 15.0).max() < 0.02
