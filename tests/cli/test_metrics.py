"""Metrics of a run: they agree with `show`, and are not lost if writing fails."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

import rcmservo as rs
from conftest import SMALL_RIG_TOML
from rcmservo.cli.cli import main
from rcmservo.cli.run_options import RunOptions
from rcmservo.cli.simulated_run.simulate import simulate
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.recording.timeline import summarise_record
from rcmservo.rig.result import METRICS_FILE

pytestmark = pytest.mark.usefixtures("blank_figures")

ENDINGS = {
    "settles": (3.0, "", ""),
    "holds": (3.0, "occlusion:at=2.5,for=9", rs.Cause.MARKERS_LOST.value),
    "is blocked": (
        3.0,
        "gain:at=1.2,factor=0,axis=1",
        "the joints do not follow the commands: ",
    ),
    "is killed": (3.0, "kill:at=1.5", "killed"),
    "is killed at its very end": (3.0, "kill:at=2.95", ""),
    "is recorded in part": (2.5, "disk_full:at=1.5", rs.Cause.NOT_RECORDED.value),
    "has too little time": (1.01, "", "time ran out before the feature errors had settled"),
}
"""Duration in s, disturbance, and words of the cause in the metrics."""

QUICK = "settles", "is killed"
"""Endings that the quick tests cover."""


def metrics_of(folder: Path, duration: float, disturbance: str = "") -> RunResult:
    """Simulate a run with small images."""
    rig = folder.with_name(f"{folder.name}.toml")
    rig.write_text(SMALL_RIG_TOML)
    options = RunOptions(
        seed=4,
        duration=duration,
        rig=rig,
        video=False,
        disturb=tuple(filter(None, [disturbance])),
        teaching_frames=10,
    )
    return simulate(options, folder)


def agree(result: RunResult, from_record: RunResult) -> None:
    """Check that both results are equal, except for the cause."""
    for name in ("settled", "settle_time_s", "remark", "loop", "feature_error", "jacobian_error"):
        assert getattr(result, name) == getattr(from_record, name)
    assert bool(result.cause) == bool(from_record.cause) != result.settled


@pytest.mark.parametrize(
    "ending",
    [pytest.param(one, marks=() if one in QUICK else pytest.mark.slow) for one in ENDINGS],
)
def test_show_and_metrics_agree_on_a_run_that(ending: str, tmp_path: Path) -> None:
    """Only the metrics hold the reason for an early end, which the record does not know."""
    seconds, disturbance, words = ENDINGS[ending]
    metrics = metrics_of(tmp_path, seconds, disturbance)
    from_record = summarise_record(reader.read_record(tmp_path))
    agree(metrics, from_record)
    assert words in metrics.cause and metrics.settled == (words == "")
    whole = "the record ends" not in from_record.cause
    assert not whole or from_record.cause == metrics.cause
    stored = json.loads((tmp_path / METRICS_FILE).read_text())
    assert stored == json.loads(json.dumps(asdict(metrics)))


@pytest.mark.slow
def test_a_run_that_ends_without_a_marker_reports_it_with_the_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    metrics = metrics_of(tmp_path, 3.5, "occlusion:at=1.5,marker=1")
    assert metrics.remark == rs.Cause.WITHOUT_MARKER_1.value
    agree(metrics, summarise_record(reader.read_record(tmp_path)))
    assert main(["show", str(tmp_path)]) == 0
    assert "marker 1 is not detected" in capsys.readouterr().out


def test_a_result_that_cannot_be_written_is_not_lost_and_no_file_is_incomplete(
    tmp_path: Path,
) -> None:
    """A folder in place of the temporary file acts as a full disk."""
    whole, part = tmp_path / "whole", tmp_path / "part"
    for folder in (whole, part):
        folder.mkdir()
    for name in (METRICS_FILE, "errors.png"):
        (part / f"{name}.part").mkdir()
    failed, written = (metrics_of(folder, 1.1) for folder in (part, whole))
    for name in (METRICS_FILE, "errors.png"):
        assert f"{name}: cannot be written" in failed.not_written
        assert not (part / name).exists() and (whole / name).exists()
    same = {"not_written": "", "folder": "", "real_time_factor": 0.0}
    assert replace(failed, **same) == replace(written, **same) and written.not_written == ""
    assert not [path for path in part.iterdir() if path.suffix == ".part" and path.is_file()]


@pytest.mark.parametrize(
    "disturbance,reason",
    [
        ("occlusion:at=0,for=9", "no green ball (marker 1) and no blue ball (marker 2)"),
        pytest.param(
            "camera_clock:at=0,for=9,s=3600", "impossible timestamps", marks=pytest.mark.slow
        ),
        pytest.param(
            "frame_drop:at=0,for=9,share=1",
            "the camera has delivered no frame",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_run_that_never_detects_the_markers_reports_the_reason(
    disturbance: str, reason: str, tmp_path: Path
) -> None:
    metrics = metrics_of(tmp_path, 1.2, disturbance)
    assert not metrics.settled and reason in metrics.cause
