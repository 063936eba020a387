"""`rcmservo paper`: reduced run, claims compared with records, report, and reproducibility."""

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import INTERRUPTIBLE_COMMAND, wait_until
from rcmservo.cli.cli import main
from rcmservo.figures import charts
from rcmservo.paper import regulation_projection_claims
from rcmservo.paper.claims import claim_table
from rcmservo.paper.experiment import experiment_named
from rcmservo.paper.lab import regulation
from rcmservo.paper.lab.paper_settings import PROJECTION_EXPLORATION
from rcmservo.paper.run import collect_results
from rcmservo.paper.store import Assignment, fingerprint, prepare
from rcmservo.recording import reader
from rcmservo.recording.outcome import SETTLED_DURATION_S

pytestmark = pytest.mark.slow

KEYS = {
    "claim",
    "where",
    "measured",
    "bound",
    "verdict",
    "seed",
    "unit",
    "relation",
    "remark",
    "experiment",
    "figure",
    "whose",
    "about",
    "case",
    "trials",
}
COMPARED = ("baselines", "path-following")
SHORTER: dict[str, dict[str, float]] = {
    "regulation-projection": {"duration": 4.0, "default_duration": 1.5},
    "regulation-flow": {"duration": 4.0},
    "showing": {"spread": 7.0, "longest": 6.0},
    "stability": {"duration": 15.0},
    "relocation": {"duration": 8.0},
    "jacobian-accuracy": {"duration": 25.0},
    "camera-knowledge": {"duration": 12.0},
    "baselines": {"accepted": 1, "draws": 20, "duration": 2.0},
    "path-following": {"approach": 4.0, "period": 6.0},
}
"""Settings (s, mm) that replace those of `--quick`: these tests need no path to its end."""
RETURNING = ("regulation-projection", "regulation-flow")
"""Experiments with a return to the start, which takes a minute with the paper's gains."""
MAX_RETURN_S, MAX_REAL_TIME_EXPLORATION_S = 2.0, 8.0
"""Time limits (s) of these experiments here."""
CHEAP = ("potential", "imaged-rcm", "tool-model")
"""Experiments that run twice: a computation, a Monte Carlo simulation, and closed loops."""


def draw_every_fifth(render: Callable[[charts.Figure], str]) -> Callable[[charts.Figure], str]:
    """Return a function that renders every fifth figure, and only builds the others.

    The layout, which the others lack, takes most of the time.
    """
    numbers = count()

    def render_some(figure: charts.Figure) -> str:
        if next(numbers) % 5 == 0:
            return render(figure)
        charts.draw_figure(figure)
        return "<svg></svg>"

    return render_some


def paper(*words: str) -> int:
    return main(["paper", *words])


@pytest.fixture(scope="module", autouse=True)
def shorter_runs() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        for name, settings in SHORTER.items():
            for key, seconds in settings.items():
                patched.setitem(claim_table().experiment[name].quick, key, seconds)
        yield


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a reduced run.

    The command finds the results of the experiments with a return, as if it continued a run.
    """
    folder = tmp_path_factory.mktemp("paper") / "quick"
    prepare(folder, quick=True)
    jobs = [job for name in RETURNING for job in assignments(name, folder)]
    exploration = replace(PROJECTION_EXPLORATION, max_time=MAX_REAL_TIME_EXPLORATION_S)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(regulation, "RETURN_TIMEOUT_S", MAX_RETURN_S)
        patched.setattr(regulation_projection_claims, "PROJECTION_EXPLORATION", exploration)
        for job in jobs:
            job.perform()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(charts, "render_svg", draw_every_fifth(charts.render_svg))
        assert paper("--quick", "--out", str(folder)) == 0
    return folder


@pytest.fixture(scope="module")
def claims(quick: Path) -> list[dict[str, Any]]:
    return json.loads(
        (quick / "claims.json").read_text(),
        parse_constant=lambda name: pytest.fail(f"{name} in JSON"),
    )


def of(claims: list[dict[str, Any]], experiment: str, words: str, case: str) -> dict[str, Any]:
    """Return the only claim of an experiment with `words` in it and `case` in its case."""
    found = [
        row
        for row in claims
        if row["experiment"] == experiment and words in row["claim"] and case in row["case"][0]
    ]
    assert len(found) == 1, f"{len(found)} claims of {experiment} contain {words!r}"
    return found[0]


def values(quick: Path, task: str) -> dict[str, Any]:
    return json.loads((quick / task / "result.json").read_text())["values"]


def test_every_experiment_has_claims_with_number_bound_verdict_and_seed(
    claims: list[dict[str, Any]],
) -> None:
    assert {row["experiment"] for row in claims} == set(claim_table().experiment)
    for row in claims:
        assert row.keys() >= KEYS
        assert row["claim"]
        assert row["where"]
        number, bound = row["measured"], row["bound"]
        holds = number <= bound if row["relation"] == "<=" else number >= bound
        verdict = (
            "does not hold" if not holds else "holds with a remark" if row["remark"] else "holds"
        )
        assert row["verdict"] == (None if row["trials"] in (1, 2) else verdict)
        assert (row["whose"] == "rcmservo") == (row["about"] == "rcmservo")


def test_the_reduced_run_gives_and_reports_no_verdict_on_one_or_two_trials(
    claims: list[dict[str, Any]], quick: Path
) -> None:
    few = [row for row in claims if row["trials"] in (1, 2)]
    assert len(few) > 50
    assert not any(row["verdict"] for row in few)
    assert "<strong>no\nverdict</strong>" in (quick / "report.html").read_text()


def test_every_sentence_of_the_paper_has_one_row_on_the_first_page(quick: Path) -> None:
    page = (quick / "report.html").read_text().split('id="software"')[0]
    sentences = re.findall(r"<q>(.*?)</q>", page, re.S)
    assert sentences == [sentence.wording for sentence in claim_table().sentence.values()]


def test_no_claim_occurs_twice_for_the_same_case(claims: list[dict[str, Any]]) -> None:
    keys = [(row["about"], row["claim"], tuple(row["case"])) for row in claims]
    assert len(keys) == len(set(keys))


@pytest.mark.parametrize(
    "words",
    [
        "Lemma 1",
        "Proposition 1",
        "Proposition 2",
        "(33)",
        "(16)",
        "(32)",
        "Fig. 5",
        "Fig. 9",
        "Fig. 10",
        "Fig. 11",
        "Fig. 12",
        "Fig. 14",
        "V",
        "Remark 3",
    ],
)
def test_every_theorem_and_figure_has_a_claim(words: str, claims: list[dict[str, Any]]) -> None:
    assert any(re.search(rf"(^|[ ,]){re.escape(words)}($|[ ,])", row["where"]) for row in claims)


def test_the_systems_that_the_paper_refers_to_have_claims(
    claims: list[dict[str, Any]],
) -> None:
    compared = " ".join(
        row["claim"] + row["where"] for row in claims if row["experiment"] in COMPARED
    )
    for words in ("Broyden", "[12]", "[20]", "[10]"):
        assert words in compared


@pytest.mark.parametrize("method", ["projection", "flow"])
def test_the_remaining_errors_agree_with_the_record(method: str, quick: Path) -> None:
    run = values(quick, f"regulation-{method}/seed-0")
    rows = reader.read_record(quick / f"regulation-{method}" / "seed-0" / "record.mcap")
    end = rows.time > rows.time[-1] - 2.0
    left = np.sqrt(np.mean(rows.ticks["delta"][end] ** 2, axis=0)) / (np.radians(40.0), 80.0, 60.0)
    assert run["left"] == pytest.approx(left.max(), rel=0.2)


@pytest.mark.parametrize(
    ("task", "case"),
    [
        ("regulation-projection/random-0", "random observations"),
        ("regulation-projection/seed-0", "chosen observations"),
        ("regulation-flow/seed-0", "half-way"),
    ],
)
def test_the_slope_agrees_with_the_record(
    task: str, case: str, quick: Path, claims: list[dict[str, Any]]
) -> None:
    row = of(claims, task.partition("/")[0], "falls by 1 px/s", case)
    rows = reader.read_record(quick / task / "record.mcap")
    began = values(quick, task)["began"]
    size = np.abs(rows.ticks["delta"][:, 1])
    saturated = (rows.time > began + 0.1) & (size > 12.0)
    A = np.stack([rows.time[saturated], np.ones(saturated.sum())], axis=1)
    slope = -np.linalg.lstsq(A, size[saturated])[0][0]
    assert row["measured"] == pytest.approx(abs(slope - 1.0), abs=0.01)


@pytest.mark.parametrize("method", ["projection", "flow"])
def test_the_pose_errors_of_the_visits_agree_with_the_record(
    method: str, quick: Path, claims: list[dict[str, Any]]
) -> None:
    folder = f"showing/{method}-0"
    found = values(quick, folder)
    rows = reader.read_record(quick / folder / "record.mcap")
    errors = list[float]()
    for visit in found["visits"]:
        last = np.flatnonzero(rows.time <= visit["ended"])[-1]
        error = rows.truth["p2"][last] - np.array(found["poses"][visit["pose"]])
        errors.append(float(np.linalg.norm(error)))
    (row,) = (
        row
        for row in claims
        if "the median visit ends within 0.5 mm" in row["claim"] and method in row["case"][0]
    )
    assert row["measured"] == pytest.approx(np.median(errors), abs=0.05)


def test_the_relocation_of_the_camera_agrees_with_the_record(quick: Path) -> None:
    rows = reader.read_record(quick / "relocation" / "projection-0" / "record.mcap")
    found = values(quick, "relocation/projection-0")
    after = rows.time > found["moved"] + found["stopped_after"] - 1e-6
    waiting = after & (rows.time < found["again"])
    assert not rows.ticks["command"][waiting].any()
    assert {cause for cause, here in zip(rows.cause, waiting, strict=True) if here} == {
        "CAMERA_MOVED"
    }
    end = rows.time > rows.time[-1] - SETTLED_DURATION_S
    assert (np.abs(rows.ticks["delta"][end]).mean(axis=0) < (0.02, 2.0, 2.0)).all()


def test_the_errors_of_the_jacobian_agree_with_the_record(quick: Path) -> None:
    run = values(quick, "regulation-projection/seed-0")
    rows = reader.read_record(quick / "regulation-projection" / "seed-0" / "record.mcap")
    explored = next(i for i, phase in enumerate(rows.phase) if phase == "SERVO")
    assert run["explored"] == pytest.approx(rows.truth["jacobian_error"][explored, 0], rel=1e-9)


def test_the_report_is_self_contained_and_its_links_have_targets(quick: Path) -> None:
    page = (quick / "report.html").read_text()
    anchors = set(re.findall(r'id="([^"]+)"', page))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= anchors
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert "http" not in re.sub(r"data:[^\"]+", "", page)
    for name in claim_table().experiment:
        assert name in anchors
    assert "simulation" in page
    assert "--quick" in page


def test_every_figure_has_labelled_axes(quick: Path) -> None:
    figures = json.loads((quick / "figures.json").read_text())
    assert len(figures) > 15
    for name, figure in figures.items():
        for panel in figure["panels"]:
            assert panel["y"], name
            assert panel["x"] or panel["categories"], name
            assert panel["curves"], name


def assignments(name: str, out: Path) -> list[Assignment]:
    """Return the tasks of the reduced run of an experiment, with folders in `out`."""
    tasks = experiment_named(name).plan(quick=True)
    return [Assignment(task, out / name / task.name, fingerprint(task)) for task in tasks]


@pytest.mark.parametrize("name", CHEAP)
def test_the_same_seed_gives_the_same_figures_bit_for_bit(
    name: str, quick: Path, tmp_path: Path
) -> None:
    """The second run is in this process, after other work."""
    jobs, experiment = assignments(name, tmp_path), experiment_named(name)
    for job in jobs:
        job.perform()
    figures = experiment.draw(experiment.settings(quick=True), collect_results(jobs))
    charts = {f"{name}/{one.name}": asdict(one.chart) for one in figures if one.chart is not None}
    second = json.loads(json.dumps(charts))
    first = json.loads((quick / "figures.json").read_text())
    assert second
    assert second == {key: first[key] for key in first if key.startswith(name + "/")}


def test_a_second_run_into_the_same_folder_finds_all_tasks_finished(quick: Path) -> None:
    jobs = [job for name in claim_table().experiment for job in assignments(name, quick)]
    assert len(jobs) > 50
    assert all(job.is_finished for job in jobs)


def test_a_run_stopped_by_ctrl_c_keeps_finished_tasks_and_can_continue(
    quick: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "stopped"
    folder.mkdir()
    shutil.copy(quick / "paper.json", folder)
    shutil.copytree(quick / "potential", folder / "potential")
    shutil.copytree(quick / "imaged-rcm", folder / "imaged-rcm")
    words = [sys.executable, "-c", INTERRUPTIBLE_COMMAND, "paper", "--quick", "--out", str(folder)]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    ) as run:
        wait_until(lambda: any(folder.glob("*/*.part/record.mcap")), run)
        run.send_signal(signal.SIGINT)
        out, errors = run.communicate()
    assert run.returncode == 130, errors
    assert b"Traceback" not in errors
    assert str(folder).encode() in out.replace(b"\n", b"")
    assert not (folder / "claims.json").exists()
    assert (folder / "potential" / "action" / "result.json").exists()
    assert paper("--quick", "--only", "potential", "--out", str(folder)) == 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--only", "regulation"], "--only must be one of regulation-projection"),
        (["--quick", "--out", "FULL"], "FULL: is not empty"),
        (["--out", "QUICK"], "QUICK: holds a quick run"),
        (["--out", "DAMAGED"], "paper.json: is damaged"),
    ],
)
def test_bad_input_gives_one_sentence_and_changes_no_file(
    words: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, file, text in (
        ("FULL", "mine.txt", "mine"),
        ("QUICK", "paper.json", '{"mode": "quick"}'),
        ("DAMAGED", "paper.json", "{"),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).write_text(text)
    before = sorted(tmp_path.rglob("*"))
    assert paper(*words) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert not printed.out
    assert sorted(tmp_path.rglob("*")) == before
