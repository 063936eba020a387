"""What `rcmservo run` promises: its JSON, its folder, its exit codes, and a record that survives Ctrl-C."""

import json
import math
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rcmservo import record
from rcmservo.cli import main

KEYS = {
    "seed", "estimator", "settled", "cause", "settle_time_s", "pose_error_mm", "feature_error", "jacobian_error",
    "explore", "real_time_factor", "folder",
}  # fmt: skip


def strict(text: str) -> Any:
    """JSON without NaN and Infinity."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, Path]:
    folder = tmp_path_factory.mktemp("run") / "deep" / "run"
    return main(["run", "--seed", "4", "--duration", "7", "--frames", "--out", str(folder)]), folder


def test_run_prints_one_json_object_and_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["run", "--seed", "2", "--duration", "7", "--no-video", "--json", "--out", str(tmp_path)])
    out = capsys.readouterr().out
    metrics = strict(out)
    assert code == 0
    assert out.count("\n") == 1
    assert set(metrics) >= KEYS
    assert set(metrics["feature_error"]) == {"s_rad", "r_px", "d_px"}
    assert set(metrics["jacobian_error"]) == {"explored", "final"}
    assert set(metrics["explore"]) == {"time_s", "path_mm", "max_excursion_mm"}
    assert metrics["settled"] is True
    assert metrics["cause"] == ""
    assert metrics["pose_error_mm"] < 1.0
    assert metrics["explore"]["time_s"] <= 3.0
    assert metrics["explore"]["max_excursion_mm"] <= 10.0
    assert metrics == strict((tmp_path / "metrics.json").read_text())
    assert not (tmp_path / "overlay.mp4").exists()


def test_a_settled_run_ends_with_0_and_leaves_record_figures_and_video(finished: tuple[int, Path]) -> None:
    code, folder = finished
    assert code == 0
    for name in ("errors.png", "estimate.png"):
        assert cv2.imread(str(folder / name)) is not None
    video = cv2.VideoCapture(str(folder / "overlay.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == pytest.approx(7 * 60, abs=3)
    assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (640, 480)
    assert not list(folder.glob("*.part"))


def test_the_metrics_follow_from_the_record(finished: tuple[int, Path]) -> None:
    _, folder = finished
    metrics, rows = strict((folder / "metrics.json").read_text()), record.read(folder / record_name())
    last = rows.time > rows.time[-1] - 1.0
    s, r, d = np.sqrt(np.mean(rows.ticks["delta"][last] ** 2, axis=0))
    assert metrics["feature_error"] == pytest.approx({"s_rad": s, "r_px": r, "d_px": d})
    small = (np.abs(rows.ticks["delta"]) < [math.radians(0.5), 1.0, 1.0]).all(axis=1)
    assert metrics["settle_time_s"] == pytest.approx(rows.time[np.flatnonzero(~small)[-1] + 1])
    assert metrics["jacobian_error"]["final"] == rows.truth["jacobian_error"][-1, 0]
    assert rows.complete
    assert len(rows.time) == 700


def record_name() -> str:
    from rcmservo.simulate import RECORD

    return RECORD


def test_what_run_recorded_can_be_replayed(finished: tuple[int, Path], capsys: pytest.CaptureFixture[str]) -> None:
    _, folder = finished
    assert main(["replay", str(folder / "recording"), "--json"]) == 0
    report = strict(capsys.readouterr().out)
    assert len(report["frames"]) == pytest.approx(7 * 60, abs=3)
    assert all(row["m1"] and row["m2"] for row in report["frames"])
    assert max(report["reprojection_rms_px"].values()) < 2.0
    assert report["one_step_rms"]["projection"]["r_px"] < report["one_step_rms"]["no_motion"]["r_px"]


def test_the_same_seed_gives_the_same_record(tmp_path: Path) -> None:
    rows = []
    for name in "ab":
        main(["run", "--seed", "5", "--duration", "2", "--no-video", "--json", "--out", str(tmp_path / name)])
        rows.append(record.read(tmp_path / name / record_name()))
    for name in rows[0].ticks:
        np.testing.assert_array_equal(rows[0].ticks[name], rows[1].ticks[name])


def test_ctrl_c_in_the_middle_of_a_run_leaves_a_readable_record_and_130(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    arguments = ["run", "--duration", "600", "--no-video", "--out", str(folder)]
    program = f"import sys; from rcmservo.cli import main; sys.exit(main({arguments!r}))"
    with subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, stdout=subprocess.PIPE) as run:
        while run.poll() is None and not (folder / record_name()).exists():
            pass
        while run.poll() is None and (folder / record_name()).stat().st_size < 100_000:
            pass
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate()
    assert run.returncode == 130
    assert b"Traceback" not in errors
    rows = record.read(folder / record_name())
    assert rows.complete
    assert len(rows.time) > 20
    assert not (folder / "metrics.json").exists()
