"""Result of a run as a table, as JSON and in one line, and invalid options of `rcmservo live`."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcmservo.cli.cli import main
from rcmservo.cli.result_output import print_result
from rcmservo.cli.terminal import open_console
from rcmservo.loop.run_result import (
    CameraStatistics,
    LoopTiming,
    RunResult,
    TimeSpread,
    time_spread,
)
from rcmservo.rig.result import METRICS_FILE, save_result

CAUSE = "the servo process was killed (SIGKILL)"
FAILED_RUN = RunResult(cause=CAUSE, folder="runs/[a]")


def printed(**more: Any) -> str:
    """Return the text of the table in one line."""
    out = open_console()
    with out.capture() as got:
        assert print_result(out, replace(FAILED_RUN, **more), as_json=False) == 1
    return " ".join(got.get().replace("│", " ").split())


def test_a_live_result_reports_an_incomplete_record() -> None:
    text = printed(not_recorded="No space left on [device]")
    assert "not recorded" in text and "No space left on [device]" in text
    assert "not recorded" not in printed()


def test_a_live_result_that_cannot_be_written_is_reported_and_not_lost(tmp_path: Path) -> None:
    """A folder in place of the temporary file acts as a full disk."""
    (tmp_path / f"{METRICS_FILE}.part").mkdir()
    result = save_result(FAILED_RUN, None, tmp_path)
    assert f"{METRICS_FILE}: cannot be written" in result.not_written
    assert (
        "not written" in printed(not_written=result.not_written) and "not written" not in printed()
    )


def test_a_live_result_has_its_cause_its_folder_and_the_loop_timing() -> None:
    loop = LoopTiming(
        200,
        missed=2,
        rate_hz=99.5,
        lateness_ms=TimeSpread(0.25, 0.5, 1.5),
        collections=0,
        refused=["paging [1] may delay"],
    )
    text = printed(loop=loop)
    for words in (CAUSE, "runs/[a]", "2 of 200", "99.500 Hz", "p99 0.50 ms", "paging [1]"):
        assert words in text
    assert "latency" not in text and "lateness" not in printed()


def test_a_hardware_result_has_its_drive_its_camera_and_its_speed() -> None:
    camera = CameraStatistics(100, 2, 1, 3, trouble="no whole frame has come for 2 s")
    text = printed(drive_off="axis B", camera=camera, speed_scale=0.1, rig_checked=False)
    for words in (
        "arm axis B",
        "100 frames, 2 lost, 1 incomplete, reopened 3 x; exposure times unchecked; no whole",
        "at most 10 %: rig check has not passed",
    ):
        assert words in text
    assert "exposure times to 0.50 ms" in printed(camera=replace(camera, uncertainty_ms=0.5))


def test_unknown_values_are_null_in_json() -> None:
    plain = json.loads(json.dumps(asdict(replace(FAILED_RUN, loop=LoopTiming()))))
    assert plain["loop"]["rate_hz"] is None and plain["loop"]["lateness_ms"]["p99"] is None
    assert plain["feature_error"] == {"s_rad": None, "r_px": None, "d_px": None}
    assert time_spread(np.empty(0)) == TimeSpread()


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (RunResult(True, "", settle_time_s=1.92), "arrived, 1.9 s"),
        (
            RunResult(True, "", settle_time_s=1.92, pose_error_mm=0.021, bound_mm=0.05),
            "arrived, error 0.02 mm (bound 0.05), 1.9 s",
        ),
        (replace(FAILED_RUN, pose_error_mm=3.0), f"not arrived: {CAUSE}, error 3.00 mm"),
    ],
)
def test_a_result_is_printed_in_one_line(result: RunResult, words: str) -> None:
    assert str(result) == words


@pytest.mark.parametrize(
    "words,sentence",
    [
        (["--seed", "-1"], "--seed must be a whole number"),
        (["--duration", "0.5"], "--duration must be more than 1"),
        (["--rig", "none.toml"], "none.toml"),
        (["--frames"], "--frames"),
    ],
)
def test_invalid_live_options_give_one_sentence_and_leave_no_folder(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["live", *words, "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert sentence in message and message.count("\n") == 1
    assert not out.exists()


def test_run_has_no_live_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--live", "--out", str(tmp_path / "out")]) == 2
    assert "--live" in capsys.readouterr().err
