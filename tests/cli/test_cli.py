"""`rcmservo run`: JSON, folder, exit codes, and a record that is readable after Ctrl-C."""

import json
import math
import signal
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest

import rcmservo as rs
from conftest import SMALL_RIG_TOML, wait_until
from rcmservo.cli.cli import main
from rcmservo.figures.video import VideoWriter
from rcmservo.recording import reader
from rcmservo.recording.reader import RECORD

pytestmark = pytest.mark.usefixtures("blank_figures")

KEYS = {
    "seed",
    "estimator",
    "settled",
    "cause",
    "settle_time_s",
    "pose_error_mm",
    "feature_error",
    "jacobian_error",
    "explore",
    "real_time_factor",
    "folder",
}


class Finished(NamedTuple):
    """Run that all tests read: exit code, output and folder."""

    code: int
    printed: str
    folder: Path


def strict(text: str) -> Any:
    """Parse JSON without NaN and Infinity."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a rig file with small images."""
    rig = tmp_path_factory.mktemp("rig") / "small.toml"
    rig.write_text(SMALL_RIG_TOML)
    return str(rig)


@pytest.fixture(scope="module")
def finished(rig: str, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """Run until the tool is at rest at the target, with all files and with JSON."""
    folder = tmp_path_factory.mktemp("run") / "deep" / "run"
    words = ["run", "--rig", rig, "--seed", "4", "--duration", "3", "--frames", "--json"]
    printed = StringIO()
    with redirect_stdout(printed):
        code = main([*words, "--teaching-frames", "30", "--out", str(folder)])
    return Finished(code, printed.getvalue(), folder)


@pytest.fixture(scope="module")
def small(rig: str) -> list[str]:
    """Return arguments of `run` with small images, no video, and JSON."""
    return ["run", "--rig", rig, "--no-video", "--json", "--teaching-frames", "30"]


def test_run_prints_one_json_object_and_nothing_else(finished: Finished) -> None:
    metrics = strict(finished.printed)
    assert finished.printed.count("\n") == 1
    assert set(metrics) >= KEYS
    assert set(metrics["feature_error"]) == {"s_rad", "r_px", "d_px"}
    assert set(metrics["jacobian_error"]) == {"explored", "final"}
    assert set(metrics["explore"]) == {"time_s", "path_mm", "max_excursion_mm"}
    assert metrics["settled"] is True
    assert metrics["cause"] == ""
    assert metrics["pose_error_mm"] < 1.0
    assert metrics["explore"]["time_s"] <= 3.0
    assert metrics["explore"]["max_excursion_mm"] <= 10.0
    assert metrics == strict((finished.folder / "metrics.json").read_text())


def test_a_settled_run_ends_with_0_and_leaves_record_figures_and_video(
    finished: Finished,
) -> None:
    assert finished.code == 0
    for name in ("errors.png", "estimate.png"):
        assert cv2.imread(str(finished.folder / name)) is not None
    video = cv2.VideoCapture(str(finished.folder / "overlay.webm"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == pytest.approx(3 * 15, abs=2)
    assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (320, 240)
    assert not list(finished.folder.glob("*.part"))


def test_the_metrics_follow_from_the_record(finished: Finished) -> None:
    folder = finished.folder
    metrics, rows = (
        strict((folder / "metrics.json").read_text()),
        reader.read_record(folder / RECORD),
    )
    last = rows.time > rows.time[-1] - 1.0
    s, r, d = np.sqrt(np.mean(rows.ticks["delta"][last] ** 2, axis=0))
    assert metrics["feature_error"] == pytest.approx({"s_rad": s, "r_px": r, "d_px": d})
    small = (np.abs(rows.ticks["delta"]) < [math.radians(0.5), 1.0, 1.0]).all(axis=1)
    assert metrics["settle_time_s"] == pytest.approx(rows.time[np.flatnonzero(~small)[-1] + 1])
    assert metrics["jacobian_error"]["final"] == rows.truth["jacobian_error"][-1, 0]
    assert rows.complete
    assert len(rows.time) == 300


def test_replay_recomputes_a_recorded_run_bit_for_bit(
    finished: Finished, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = finished.folder
    assert main(["replay", str(folder)]) == 0
    assert capsys.readouterr().out == "all 300 ticks came out the same, bit for bit\n"


def test_replay_with_other_settings_reports_an_open_loop_and_the_differences(
    finished: Finished, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = finished.folder
    assert main(["replay", str(folder), "--controller.gain", "4", "--json"]) == 1
    output = strict(capsys.readouterr().out)
    assert (
        output["open_loop"]
        and not output["same"]
        and set(output["differs"]) <= {"v", "command", "phase"}
    )
    assert main(["replay", str(folder), "--estimator", "flow"]) == 1
    text = capsys.readouterr().out
    assert (
        text.startswith("open loop, with other settings: from tick 0") and "ticks in SERVO" in text
    )
    for arguments in (["--rig", "examples/davinci.toml"], ["--out", "somewhere"]):
        assert main(["replay", str(folder), *arguments]) == 2
        text = capsys.readouterr().err
        assert "left out for a run" in text and text.endswith(
            f", got {arguments[1]!r}; see rcmservo replay --help\n"
        )


@pytest.mark.slow
def test_replay_distinguishes_the_two_projection_estimators(
    small: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A record of one of them differs only with the other.

    Changed settings apply to the recorded one.
    """
    names = "projection", "projection-printed"
    for name in names:
        main([*small, "--duration", "1.2", "--estimator", name, "--out", str(tmp_path / name)])
        for given, same in (((), True), *(((other,), other == name) for other in names)):
            capsys.readouterr()
            words = ["--estimator", *given] if given else []
            assert main(["replay", str(tmp_path / name), *words, "--json"]) == (0 if same else 1)
            output = strict(capsys.readouterr().out)
            assert (output["same"], output["open_loop"]) == (same, not same)
    assert (
        main(["replay", str(tmp_path / names[1]), "--projection.observations", "30", "--json"]) == 1
    )
    assert strict(capsys.readouterr().out)["open_loop"]


@pytest.mark.slow
def test_exported_frames_form_a_recording_that_replay_scores(
    finished: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = finished.folder
    assert main(["export", str(folder), "--out", str(tmp_path / "export")]) == 0
    capsys.readouterr()
    assert main(["replay", str(tmp_path / "export" / "recording"), "--json"]) == 0
    report = strict(capsys.readouterr().out)
    assert len(report["frames"]) == pytest.approx(3 * 60, abs=3)
    assert all(row["m1"] and row["m2"] for row in report["frames"])
    assert max(report["reprojection_rms_px"].values()) < 2.0
    assert (
        report["one_step_rms"]["projection"]["r_px"] < report["one_step_rms"]["no_motion"]["r_px"]
    )


@pytest.mark.slow
def test_run_accepts_disturbances_an_operator_and_a_target_file(
    small: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A marker is lost, the camera moves, and the target is taught again.

    The target of the earlier view is refused later.
    """
    target = str(tmp_path / "target.json")
    faults = ["--disturb", "occlusion:at=2.4,for=0.3", "--disturb", "relocate:at=3.2"]
    saving = [*faults, "--resumes", "3", "--duration", "10", "--save-target", target]
    assert main([*small, "--seed", "1", *saving, "--out", str(tmp_path / "a")]) == 0
    captured = capsys.readouterr()
    metrics = strict(captured.out)
    assert metrics["taught_again"] == 1 and metrics["pose_error_mm"] < 1.0
    for cause in (rs.Cause.MARKERS_LOST, rs.Cause.CAMERA_MOVED):
        assert cause.value in captured.err and cause.remedy in captured.err
    again = ["--duration", "3.5", "--target", target]
    assert main([*small, "--seed", "1", *again, "--out", str(tmp_path / "b")]) == 0
    capsys.readouterr()
    assert main([*small, "--seed", "5", *again, "--out", str(tmp_path / "c")]) == 2
    assert "was taught with camera" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()
    assert main([*small, "--save-target", target, "--out", str(tmp_path / "c")]) == 2
    assert "is not overwritten" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words,sentence",
    [
        (["--disturb", "oclusion:at=3"], "did you mean occlusion?"),
        (["--disturb", "frame_drop:at=-1"], "frame_drop: at must be a time in s"),
        (["--resumes", "-1"], "--resumes must be"),
        (
            ["--target", "a.json", "--save-target", "b.json"],
            "--save-target must be left out with --target, where no target",
        ),
        (["--save-target", "nowhere/b.json"], "nowhere is not a folder that you can write to"),
    ],
)
def test_an_invalid_request_gives_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *words, "--out", str(tmp_path / "out")]) == 2
    text = capsys.readouterr().err.splitlines()
    assert sentence in text[-1]
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_full_disk_pauses_the_run_and_leaves_a_readable_record(
    small: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    full = ["--seed", "4", "--duration", "3", "--disturb", "disk_full:at=1.5"]
    assert main([*small, *full, "--out", str(tmp_path)]) == 1
    metrics = strict(capsys.readouterr().out)
    assert (
        rs.Cause.NOT_RECORDED.value in metrics["cause"]
        and "No space left" in metrics["not_recorded"]
    )
    rows = reader.read_record(tmp_path / RECORD)
    assert 1.0 < rows.time[-1] <= 1.6 and not rows.complete
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["show", str(tmp_path), "--out", str(tmp_path / "shown")]) == 0
    assert f"the record ends at {rows.time[-1] + 0.01:.2f} s of 3.00 s" in capsys.readouterr().out


def test_a_failed_video_is_removed_and_reported_and_the_run_continues(
    rig: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(VideoWriter, "write", lambda self, image: None)
    words = ["run", "--rig", rig, "--duration", "1.1", "--teaching-frames", "10"]
    assert main([*words, "--out", str(tmp_path)]) == 1
    assert (
        "not filmed" in (text := capsys.readouterr().out)
        and "overlay.webm could not be written" in text
    )
    assert "was removed" in strict((tmp_path / "metrics.json").read_text())["not_filmed"]
    assert not (tmp_path / "overlay.webm").exists() and (tmp_path / RECORD).exists()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_record(
    finished: Finished, small: list[str], tmp_path: Path
) -> None:
    """Also without video and frames, and until the end of a shorter run."""
    assert main([*small, "--seed", "4", "--duration", "1.2", "--out", str(tmp_path)]) == 1
    shorter, whole = (
        reader.read_record(path / RECORD).ticks for path in (tmp_path, finished.folder)
    )
    for name, column in shorter.items():
        assert len(column) == 120
        np.testing.assert_array_equal(column, whole[name][:120])


def test_ctrl_c_during_a_run_names_the_folder_of_a_readable_record(
    small: list[str], tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    arguments = [word for word in small if word != "--json"]
    arguments += ["--duration", "600", "--out", str(folder)]
    with subprocess.Popen(
        [sys.executable, "-m", "rcmservo", *arguments],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as run:
        record = folder / RECORD
        wait_until(lambda: record.exists() and record.stat().st_size > 100_000, run)
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate()
    assert run.returncode == 130
    assert errors == f"rcmservo: stopped by Ctrl-C; the results so far are in {folder}\n"
    rows = reader.read_record(folder / RECORD)
    assert rows.complete
    assert len(rows.time) > 20
    assert not (folder / "metrics.json").exists()
    assert not list(folder.glob("overlay.webm*"))
