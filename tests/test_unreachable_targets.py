"""Unreachable targets: the run ends unsettled at rest, with its cause in words and exit code 1."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import SMALL_RIG_TOML
from rcmservo.cli.cli import main
from rcmservo.loop.run_result import FinalPose
from rcmservo.recording import reader
from rcmservo.recording.final_pose import RunCourse
from rcmservo.recording.outcome import judge_run
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Mode, Phase

OPTIONS = ["--no-video", "--json", "--teaching-frames", "10"]
IMAGE_ALONE = ["--controller.joint-trust", "0"]
"""With the joints of teaching the tool reaches the target at a singular surface."""

UNREACHABLE_TARGETS = {
    "a marker leaves the image": (
        """
        [scene]
        start = [0.33, -0.68, 93.74]
        target = [1.01, -0.92, 60.0]
        focal = [850.0, 900.0]
        distance = [120.0, 140.0]
        [thresholds]
        max_single_marker_deviation = 0.0
        """,
        3,
        "is not detected",
    ),
    "at a singular surface": (
        """
        [scene]
        start = [0.35, 1.92, 117.83]
        target = [0.86, 0.99, 148.07]
        """,
        1,
        "singular surface",
    ),
    "beyond a singular surface, where the same image is another pose": (
        """
        [scene]
        start = [0.3, 0.0, 100.0]
        target = [1.2, 3.0, 100.0]
        """,
        0,
        "singular surface looks the same",
    ),
}


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("case", UNREACHABLE_TARGETS)
def test_an_unreachable_target(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, seed, words = UNREACHABLE_TARGETS[case]
    rig, out = tmp_path / "rig.toml", tmp_path / "out"
    rig.write_text(text)
    arguments = ["run", "--rig", str(rig), "--seed", str(seed), "--duration", "6", *OPTIONS]
    assert main([*arguments, *IMAGE_ALONE, "--out", str(out)]) == 1
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["settled"] is False
    assert metrics["settle_time_s"] is None
    assert words in metrics["cause"]
    rows = reader.read_record(out / "record.mcap")
    if rows.phase[-1] == "PAUSED":
        assert not rows.ticks["command"][-1].any()
        noticed = max(i for i, phase in enumerate(rows.phase) if phase not in ("HOLD", "PAUSED"))
        assert np.linalg.norm(rows.truth["p1"][-1] - rows.truth["p1"][noticed]) < 3.0, (
            "it stopped where it noticed"
        )
    else:
        moved = np.linalg.norm(np.diff(rows.truth["p1"][-10:], axis=0), axis=1) * 100.0
        assert rows.phase[-1] == "SERVO" and moved.max() < 2.0


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_the_joints_of_teaching_lead_to_a_target_at_a_singular_surface(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, seed, _ = UNREACHABLE_TARGETS["at a singular surface"]
    rig = tmp_path / "rig.toml"
    rig.write_text(text)
    arguments = ["run", "--rig", str(rig), "--seed", str(seed), "--duration", "10", *OPTIONS]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["pose_error_mm"] < 1.0
    rows = reader.read_record(tmp_path / "out" / "record.mcap")
    p2, settled = rows.truth["p2"], rows.time >= metrics["settle_time_s"]
    assert np.linalg.norm(p2[settled] - p2[-1], axis=1).max() < 6.0, "it stayed there from then on"


@pytest.mark.slow
def test_a_target_beyond_a_joint_limit_is_not_taught(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(
        """
        [mechanism]
        kind = "spherical"
        upper = [1.4, 3.14, 120.0]
        [scene]
        start = [0.5, 0.3, 100.0]
        target = [0.5, 0.4, 135.0]
        """
    )
    words = ["run", "--rig", str(rig), "--teaching-frames", "30"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "the target cannot be taught: " in capsys.readouterr().err


@pytest.fixture
def rig(tmp_path: Path) -> str:
    path = tmp_path / "rig.toml"
    path.write_text(SMALL_RIG_TOML)
    return str(path)


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_a_run_that_ends_during_exploration_names_that_cause(
    rig: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--duration", "1.1", "--exploration.min-corners", "40", *OPTIONS]
    assert main(["run", "--rig", rig, *words, "--out", str(tmp_path / "out")]) == 1
    assert "exploration" in json.loads(capsys.readouterr().out)["cause"]


OUTCOMES = [
    (Mode(Phase.SERVO, Cause.LATE_TICK), 1.0, ""),
    (Mode(Phase.SERVO, Cause.NEARLY_SINGULAR), 1.0, ""),
    (Mode(Phase.HOLD, Cause.STALE), 1.0, Cause.STALE.text),
    (Mode(Phase.DISABLED), None, "the arm's drive is off"),
    (Mode(Phase.IDLE), None, "time ran out before both markers were seen"),
    (Mode(Phase.ACQUIRE), None, "time ran out during exploration"),
    (Mode(Phase.ACQUIRE), 1.0, "time ran out on the way back from a hold"),
]


@pytest.mark.parametrize("mode,explored,words", OUTCOMES)
def test_the_outcome_names_only_the_cause_of_the_stop(
    mode: Mode, explored: float | None, words: str
) -> None:
    course = make_course_at_target()
    assert judge_run(course, explored, mode, FinalPose(by_joints_mm=0.0)).cause == words


def make_course_at_target() -> RunCourse:
    """Return 3 s without a feature error and without motion."""
    times, zeros = np.arange(300) / 100.0, np.zeros((300, 3))
    return RunCourse(times, zeros, times, zeros, zeros, np.eye(3), np.zeros(300))


def test_a_tool_that_was_far_away_within_the_last_second_has_not_settled() -> None:
    """At a singular surface the features agree along a path of many millimetres."""
    course = make_course_at_target()
    pose = FinalPose(by_joints_mm=0.0)
    arrived = replace(course, distances=np.where(course.times < 1.5, 60.0, 0.0))
    result = judge_run(arrived, 1.0, Mode(Phase.SERVO), pose)
    assert result.settled and result.settle_time_s == 1.5
    moving = replace(course, distances=np.where(course.times < 2.5, 60.0, 0.0))
    result = judge_run(moving, 1.0, Mode(Phase.SERVO), pose)
    assert not result.settled and "at the target for a second" in result.cause


@pytest.mark.parametrize(
    ("distance_mm", "words"),
    [
        (0.9, ""),
        (1.3, "1.3 mm from its taught position by the joints: the image does not determine"),
        (12.0, "12.0 mm from its taught position by the joints: a pose beyond the singular"),
    ],
)
def test_a_run_that_the_joints_contradict_has_not_settled(distance_mm: float, words: str) -> None:
    result = judge_run(
        make_course_at_target(), 1.0, Mode(Phase.SERVO), FinalPose(by_joints_mm=distance_mm)
    )
    assert result.settled == (not words) and words in result.cause


@pytest.mark.parametrize("at", ["0", "0.02"])
@pytest.mark.usefixtures("blank_figures")
def test_a_run_that_ends_before_the_first_observation_names_its_cause(
    at: str, rig: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    words = ["--seed", "4", "--duration", "3", "--disturb", f"kill:at={at}", *OPTIONS]
    assert main(["run", "--rig", rig, *words, "--out", str(out)]) == 1
    assert "killed" in json.loads(capsys.readouterr().out)["cause"]
    assert main(["replay", str(out)]) == 0
