"""`rcmservo study` and `rcmservo tune`: output folders, and rerun rows."""

import json
import re
import shutil
import sys
from collections.abc import Generator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import pytest

import rcmservo as rs
from conftest import SMALL_RIG_TOML
from rcmservo.cli.cli import main
from rcmservo.config.user_estimators import import_estimator
from rcmservo.errors import RcmServoError
from rcmservo.figures import charts
from rcmservo.interfaces import Image
from rcmservo.study.execution import workers as crews
from rcmservo.study.execution.chunk import run_chunk
from rcmservo.study.execution.store import read_runs
from rcmservo.study.plan.plan import StudyPlan

MODULE = "lab_of_studies"
OWN = f"{MODULE}:Least"
SOURCE = """
from dataclasses import dataclass
import numpy as np
import rcmservo as rs
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm

@dataclass(frozen=True)
class Least(rs.Estimator):
    forgetting: float = 0.98
    name = "least"
    def init(self):
        return np.zeros((4, 4)), 1e6 * np.eye(4)
    def update(self, memory, tool, sample):
        A, P = memory
        x = np.append(sample.p1, 1.0)
        gain = P @ x / (self.forgetting + x @ P @ x)
        A = A + np.outer(sample.points.ravel() - A @ x, gain)
        return A, (P - np.outer(gain, P @ x)) / self.forgetting
    def jacobian(self, memory, tool, sample):
        return compute_features_jacobian(shift_to_rcm(sample.points, sample.o_c)) @ memory[0][:, :3]
"""
FILE = f"""
methods = ["dlt", "mine"]
scenes = ["random"]
count = 50
duration = 2.0
[method.mine]
estimator = "{OWN}"
controller = {{ gain = 4.0 }}
"""
SEARCH = """
scenes = ["random"]
count = 5
duration = 2.0
[method.start]
estimator = "dlt"
[search]
"controller.gain" = [2.0, 15.0]
[tune]
trials = 3
validation = 12
"""
SMALL_SCENES = "small.toml"
"""Rig file of scenes with small images: encoding a full-size frame of a video takes 50 ms."""
WRITTEN = {"parts", "report.html", "runs.parquet", "study.json", "summary.json"}


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Generator[Path]:
    """Change to a folder with a user-defined estimator and a file that names it."""
    folder = tmp_path_factory.mktemp("here")
    (folder / f"{MODULE}.py").write_text(SOURCE)
    (folder / "study.toml").write_text(FILE)
    (folder / SMALL_SCENES).write_text(SMALL_RIG_TOML)
    (folder / "search.toml").write_text(SEARCH)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "path", [*sys.path])
        yield folder
        sys.modules.pop(MODULE, None)


class LocalCrew:
    """Crew of this process, whatever the number of workers."""

    where = "this process"

    def __init__(self, count: int) -> None:
        self.count = count

    def run(self, orders: Any) -> Generator[Any]:
        for key, order in orders:
            with pytest.MonkeyPatch.context() as patch:  # the chunk brings its own module
                patch.setattr(sys, "path", [*sys.path])
                patch.delitem(sys.modules, MODULE, raising=False)
                rows = run_chunk(order)
            yield key, rows


@pytest.fixture(scope="module")
def in_this_process() -> Generator[None]:
    """Replace the workers by this process, and draw nothing."""
    from matplotlib.figure import Figure

    @contextmanager
    def crew(address: str | None, workers: int | None) -> Generator[LocalCrew]:
        yield LocalCrew(workers or 1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(crews, "open_worker_pool", crew)
        patch.setattr(charts, "draw_figure", lambda figure: Figure(figsize=(1.0, 1.0)))
        yield


@pytest.fixture(scope="module")
def study(here: Path, in_this_process: None) -> str:
    """Return the output of a study: two methods in three scenes."""
    words = ["study", "study.toml", "--user-estimator", OWN, "--count", "3", "--workers", "2"]
    words += ["--out", "study"]
    printed, errors = StringIO(), StringIO()
    with redirect_stdout(printed), redirect_stderr(errors), pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["rcmservo", *words])
        assert main(words) == 0
    assert errors.getvalue() == ""
    return printed.getvalue()


def rows(folder: str) -> list[dict[str, Any]]:
    return read_runs(Path(folder)).to_pylist()


def test_a_study_writes_rows_summary_and_report_and_shows_progress(study: str) -> None:
    assert {path.name for path in Path("study").iterdir()} == WRITTEN
    made = rows("study")
    assert [(row["method"], row["engine"], row["seed"]) for row in made] == [
        *(("dlt", "mujoco", seed) for seed in range(3)),
        *(("mine", "mujoco", seed) for seed in range(3)),
    ]
    assert made[0]["source"] == "" and len(made[3]["source"]) == 64
    lines = study.splitlines()
    assert lines[0] == "6 simulated runs, into study"
    assert lines[-1] == "rows, summary and report in study"
    assert "running: 100 % is done" in lines and "mine compared with dlt, random, 3 pairs" in study
    summary = json.loads(Path("study/summary.json").read_text())
    assert summary["workers"] == "2 on this process" and "--user-estimator" in summary["command"]
    assert f"--user-estimator {OWN} --replay 5</code>" in Path("study/report.html").read_text()


@pytest.mark.usefixtures("study")
def test_the_same_seeds_give_the_same_rows_on_the_command_line_and_in_python() -> None:
    least = import_estimator(OWN)()
    law = rs.SaturatedController(gain=4.0)
    mine = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0), least, controller=law)
    compared = rs.compare({"dlt": rs.DltEstimator(), "mine": mine}, scenes=3, duration=2.0)
    assert [asdict(row) for row in compared.rows] == rows("study")
    assert compared.engine == "mujoco" and compared.rows[0] != compared.rows[3]


def test_an_option_overrides_the_file_and_the_file_overrides_the_default(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def work(plan: StudyPlan, folder: Path) -> None:
        raise RcmServoError(f"{plan.count} {plan.noise} {plan.duration} {plan.first_seed}")

    monkeypatch.setattr("rcmservo.study.execution.run_study.StudyExecution", work)
    file = tmp_path / "study.toml"
    file.write_text("count = 50\nnoise = [0.3]\nfirst_seed = 7")
    assert main(["study", str(file), "--count", "3", "--seed", "8"]) == 2
    assert capsys.readouterr().err == "rcmservo: 3 (0.3,) 15.0 8\n"


@pytest.mark.usefixtures("in_this_process")
def test_a_repeated_command_repeats_no_run(study: str, capsys: pytest.CaptureFixture[str]) -> None:
    before = Path("study/runs.parquet").read_bytes()
    assert (
        main(["study", "study.toml", "--user-estimator", OWN, "--count", "3", "--out", "study"])
        == 0
    )
    output = capsys.readouterr().out
    assert "all runs exist already" in output and "running" not in output
    assert Path("study/runs.parquet").read_bytes() == before


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("before", [True, False])
def test_an_option_overrides_the_file_at_any_position(
    here: Path, before: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    out = f"above-{before}"
    words = [
        "--user-estimator",
        OWN,
        "--method",
        "dlt",
        "--count",
        "2",
        "--no-report",
        "--out",
        out,
    ]
    assert main(["study", *words, "study.toml"] if before else ["study", "study.toml", *words]) == 0
    made = rows(out)
    assert [(row["method"], row["seed"]) for row in made] == [("dlt", 0), ("dlt", 1)]
    assert {path.name for path in Path(out).iterdir()} == WRITTEN - {"report.html"}
    assert f"rows and summary in {out}" in capsys.readouterr().out


@pytest.mark.usefixtures("in_this_process")
def test_several_noises_follow_the_file(here: Path) -> None:
    words = ["--method", "dlt", "--count", "1", "--noise", "0.3", "1", "--out", "noises"]
    assert main(["study", "study.toml", "--user-estimator", OWN, *words]) == 0
    assert [row["noise_px"] for row in rows("noises")] == [0.3, 1.0]


def test_scenes_help_describes_each_distribution_and_runs_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["study", "--scenes", "help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80 and not list(tmp_path.iterdir())
    names = [line.split()[0] for line in lines if not line.startswith(" ")]
    assert names == ["paper", "random", "laparoscopic", "hard"]


def rerun(case: int, *words: str, folder: str = "study") -> int:
    line = ["study", "--out", folder, "--user-estimator", OWN, "--replay", str(case), *words]
    return main(line)


@pytest.mark.filterwarnings("error:::tyro")
@pytest.mark.usefixtures("study", "in_this_process")
@pytest.mark.parametrize(("case", "engine"), [(1, "compiled"), (4, "mujoco")])
def test_a_rerun_row_of_each_engine_is_equal_and_its_record_is_readable(
    case: int, engine: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if (out := "study" if engine == "mujoco" else "compiled") == "compiled":
        words = ["--method", "dlt", "--count", "2", "--duration", "2", "--no-report"]
        assert main(["study", *words, "--out", out]) == 0
        capsys.readouterr()
    assert rerun(case, folder=out) == 0
    output, folder = capsys.readouterr().out, f"{out}/replays/{case}"
    assert "the same row, bit for bit" in output and engine in output.splitlines()[0]
    assert ("recorded with MuJoCo's arm" in output) == (engine == "compiled")
    assert all(words in output for words in ("pose error", "Cramér-Rao bound", "unnoticed"))
    names = {path.name for path in Path(folder).iterdir()}
    assert names == {"record.mcap", "metadata.yaml", "errors.png", "estimate.png"}
    assert main(["show", folder, "--out", f"figures-{case}"]) == 0
    assert "simulation with seed 1" in capsys.readouterr().out
    assert (Path(f"figures-{case}") / "errors.png").exists()
    words = ["--estimator", OWN] if engine == "mujoco" else []
    assert main(["replay", folder, *words]) == 0
    assert "all 200 ticks came out the same" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("here", "in_this_process")
def test_a_rerun_writes_a_playable_video(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--method", "dlt", "--count", "1", "--duration", "1.1", "--no-report"]
    assert main(["study", *words, "--scenes", SMALL_SCENES, "--out", "filmed"]) == 0
    assert rerun(0, "--video", folder="filmed") == 0 and rerun(0, folder="filmed") == 0
    assert re.search(r"in filmed/replays/0-2;", capsys.readouterr().out)
    film, frames = cv2.VideoCapture("filmed/replays/0/overlay.webm"), list[Image]()
    assert film.get(cv2.CAP_PROP_FPS) == 60
    while (read := film.read())[0]:
        frames.append(read[1])
    assert 62 <= len(frames) <= 67 and frames[0].shape == (240, 320, 3)
    assert frames[0].std() > 10.0 and (frames[0] != frames[-1]).any(axis=2).mean() > 0.01


@pytest.mark.slow
@pytest.mark.usefixtures("here", "in_this_process")
def test_a_rerun_row_of_rendered_frames_is_equal(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--engine", "pictures", "--count", "1", "--duration", "1.1", "--teaching-frames", "5"]
    words += ["--scenes", SMALL_SCENES]
    assert main(["study", *words, "--out", "pictures"]) == 0
    (row,) = rows("pictures")
    assert row["bound_mm"] is None and row["noise_px"] is None
    assert main(["study", "--out", "pictures", "--replay", "0", "--video"]) == 0
    assert "the same row, bit for bit, recorded in" in capsys.readouterr().out


def refused(words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(words) == 2
    output = capsys.readouterr().err.strip().splitlines()
    assert len(output) == 1 and output[0].startswith("rcmservo: ") and sentence in output[0]


def test_a_run_is_not_repeated_with_other_code(
    study: str, capsys: pytest.CaptureFixture[str]
) -> None:
    note, module = Path("study/study.json"), Path(f"{MODULE}.py")
    whole, source = note.read_text(), module.read_text()
    replay = ["study", "--out", "study", "--replay", "4"]
    beyond = ["study", "--out", "study", "--user-estimator", OWN, "--replay"]
    for case in ("6", "-1"):
        refused([*beyond, case], f"--replay must be a row from 0 to 5, got {case}", capsys)
    try:
        refused(
            replay,
            f"the estimator {OWN} is code of another user: name it with --user-estimator {OWN}",
            capsys,
        )
        module.write_text(source + "# changed\n")
        refused(
            [*replay, "--user-estimator", OWN], f"the estimator {OWN} has changed since", capsys
        )
        module.write_text(source)
        note.write_text(re.sub(r'"package": "[^"]*"', '"package": "0.0.1 abc"', whole))
        refused(
            [*replay, "--user-estimator", OWN], "was made by rcmservo 0.0.1 abc, not by", capsys
        )
    finally:
        note.write_text(whole)
        module.write_text(source)
    assert not Path("study/replays/4-2").exists()


@pytest.mark.usefixtures("in_this_process")
def test_an_equal_row_of_another_processor_is_reported_as_such(
    study: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from rcmservo.study import row

    monkeypatch.setattr(row, "read_cpu_name", lambda: "another one")
    assert rerun(0) == 0
    assert "the same row, bit for bit (cpu was " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (('"engine": "mujoco",', ""), "study.cells[0].engine must be given, got None"),
        (('"count": 3', '"count": "x"'), "study.count must be a whole number, got 'x'"),
        (('"count": 3', '"count": 30'), "runs.parquet: has 6 rows, but study.json lists 60"),
    ],
)
def test_a_run_is_not_repeated_from_a_damaged_manifest(
    study: str, damage: tuple[str, str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    note = Path("study/study.json")
    whole = note.read_text()
    try:
        note.write_text(whole.replace(*damage))
        refused(["study", "--out", "study", "--replay", "0"], words, capsys)
    finally:
        note.write_text(whole)


def test_a_row_that_differs_is_reported_with_exit_code_1(
    study: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from rcmservo.study import row

    monkeypatch.setattr(row, "SUCCESS_MM", 1e9)
    assert rerun(0) == 1
    assert "the row differs in success, time_to_1mm_s, recorded" in capsys.readouterr().out


@pytest.mark.parametrize("command", [["study", "study.toml"], ["tune", "study.toml"]])
def test_user_code_that_only_the_file_names_is_not_run(
    here: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    sys.modules.pop(MODULE, None)
    refused(
        command, f"or module:class that --method or --user-estimator names, got '{OWN}'", capsys
    )
    assert MODULE not in sys.modules


@pytest.mark.slow
@pytest.mark.usefixtures("in_this_process")
def test_a_search_writes_settings_report_and_a_command_and_resumes(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tune", "search.toml", "--out", "tuned"]) == 0
    output = capsys.readouterr().out
    assert {path.name for path in Path("tuned").iterdir()} == WRITTEN | {"search", "tuned.toml"}
    assert (
        "searching: 100 % is done" in output and "testing on unseen scenes: 100 % is done" in output
    )
    assert "to use them: rcmservo run --estimator dlt" in output
    made = rows("tuned")
    assert [(row["method"], row["seed"]) for row in made] == [
        (method, seed) for method in ("start", "tuned") for seed in range(5, 17)
    ]
    page = Path("tuned/report.html").read_text()
    assert "3 trials of 5 runs, seeds 0 to 4; goal time" in page and "controller.gain" in page
    before = {path: path.read_bytes() for path in Path("tuned").rglob("*.parquet")}
    for name in WRITTEN - {"parts"}:
        (Path("tuned") / name).unlink()
    shutil.rmtree("tuned/parts")  # as after a stop during the search
    assert main(["tune", "search.toml", "--out", "tuned"]) == 0
    assert {path: path.read_bytes() for path in Path("tuned").rglob("*.parquet")} == before
    assert main(["study", "tuned/tuned.toml", "--count", "1", "--out", "again"]) == 0
    assert main(["study", "--out", "tuned", "--replay", "13"]) == 0
    assert "row 13: tuned, random, seed 6" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("in_this_process")
def test_a_search_reports_resumption_or_changes_and_ends(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def output(text: str) -> list[str]:
        Path("short.toml").write_text(text)
        assert main(["tune", "short.toml", "--out", "short"]) == 0
        return capsys.readouterr().out.splitlines()

    short = SEARCH.replace("trials = 3", "trials = 1")
    assert not [line for line in output(short) if "already" in line or "changed" in line]
    next(Path("short/parts").iterdir()).unlink()
    repeated = output(short)
    assert "existing trials are not repeated" in repeated
    assert "12 runs exist already; the others follow" in repeated
    assert "testing on unseen scenes: 100 % is done" in repeated
    other = output(short.replace("duration = 2.0", "duration = 2.5"))
    assert "duration changed since the last use of this folder: trials are repeated" in other
    assert "duration changed since the last use of this folder: 24 of 24 runs are repeated" in other


def test_settings_of_a_search_are_not_studied_in_its_own_folder(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = Path("found/tuned.toml")
    found.parent.mkdir()
    found.write_text('[method.tuned]\nestimator = "dlt"\n')
    words = ["study", str(found), "--out", "found"]
    refused(words, "--out must be a folder other than that of FILE, where tuned.toml", capsys)
    assert found.exists()
