"""Scores of recordings of points: like those of images, with an error for a short recording."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from conftest import ARM_RECORDING, ROOT, draw_calibration_matrix, make_random, project_markers
from rcmservo.cli.cli import main
from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import UnusableFile
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.projection_rule import ProjectionEstimator
from rcmservo.geometry.imaged_rcm import ImagedRcm, intersect_lines
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.recording.foreign.frame_folder import POINT_COLUMNS, load_recording
from rcmservo.recording.foreign.scoring import (
    ASSUMED_SPEED_MM_S,
    MIN_FRAMES,
    RecordingScore,
    score_recording,
)
from rcmservo.tracking import PointMarkers

LAB = RigDescription()


def write_recording(folder: Path, count: int, lost: int = 0) -> Path:
    """Write a recording of points by an exact camera; the first `lost` frames lack marker 2."""
    random = make_random(5)
    low, high = np.array([0.5, -0.6, 90.0]), np.array([0.9, 0.6, 150.0])
    joints = random.uniform(low, high, (count, 3))
    positions = np.array([LAB.mechanism.position(q) for q in joints])
    C = draw_calibration_matrix(make_random(8), positions)
    lines = ["frame,theta_rad,phi_rad,rho_m," + ",".join(POINT_COLUMNS)]
    for i, (q, p1) in enumerate(zip(joints, positions, strict=True)):
        points = [f"{x:.9f}" for x in project_markers(C, p1).ravel()]
        points[2:] = ["", ""] if i < lost else points[2:]
        lines.append(",".join([str(i), *(repr(float(x)) for x in q * [1, 1, 1e-3]), *points]))
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    return folder


def score(folder: Path) -> RecordingScore:
    estimators = {"projection": ProjectionEstimator(rate=20.0)}
    return score_recording(folder, LAB, PointMarkers(), estimators, ImagedRcm())


def test_exact_points_leave_a_small_fraction_of_the_motion_unpredicted(tmp_path: Path) -> None:
    result = score(write_recording(tmp_path, 40))
    no_motion, projection = result.one_step["no_motion"], result.one_step["projection"]
    assert np.all(projection < 0.05 * no_motion)
    assert np.all(result.reprojection < 0.05 * no_motion[1])


def test_eq_16_as_printed_can_be_scored(tmp_path: Path) -> None:
    """The fit uses the lines of the last frames."""
    estimators = {"projection": ProjectionEstimator(rate=20.0)}
    printed = ImagedRcm(lines=4, fit="printed", max_condition=1e12)
    result = score_recording(
        write_recording(tmp_path, 40), LAB, PointMarkers(), estimators, printed
    )
    last = np.array([found.points.ravel() for found in result.markers[-4:]])
    assert np.array_equal(result.o_c, intersect_lines(last).o_c)


def test_frames_without_both_markers_are_left_out(tmp_path: Path) -> None:
    result = score(write_recording(tmp_path, MIN_FRAMES + 3, lost=3))
    assert sum(np.isfinite(found.points).all() for found in result.markers) == MIN_FRAMES
    assert np.isfinite(result.one_step["projection"]).all()


class IntervalEstimator(Estimator):
    """Estimator that records the time between its samples."""

    def init(self) -> list[float]:
        return []

    def update(self, memory: list[float], tool: Tool, sample: Sample) -> list[float]:
        return [*memory, sample.dt]

    def jacobian(self, memory: list[float], tool: Tool, sample: Sample) -> Floats:
        recorded_intervals.append(memory)
        return np.zeros((3, 3))


recorded_intervals: list[list[float]] = []


def test_an_estimator_receives_the_time_since_its_last_update(tmp_path: Path) -> None:
    """The first time is 0. Frames without o_c are skipped, and their time counts."""
    folder = write_recording(tmp_path, 20)
    recorded_intervals.clear()
    score_recording(
        folder,
        LAB,
        PointMarkers(),
        {"intervals": IntervalEstimator()},
        ImagedRcm(lines=4, fit="printed", max_condition=17.0),
    )
    poses = load_recording(folder, LAB.mechanism, LAB.tool)
    distances = [np.linalg.norm(b.p1 - a.p1) for a, b in itertools.pairwise(poses)]
    times = np.cumsum(distances) / ASSUMED_SPEED_MM_S
    first, *others = recorded_intervals[-1]
    updates = times[0] + np.cumsum(others)
    nearest = np.abs(times[:, None] - updates).argmin(axis=0)
    assert first == 0.0 and times[nearest] == pytest.approx(updates)
    assert np.diff(nearest).max() > 1, "some frames were left out"


@pytest.mark.parametrize(("count", "lost"), [(3, 0), (MIN_FRAMES - 1, 0), (MIN_FRAMES + 3, 4)])
def test_too_few_frames_are_reported(count: int, lost: int, tmp_path: Path) -> None:
    with pytest.raises(UnusableFile) as caught:
        score(write_recording(tmp_path, count, lost))
    sentence = str(caught.value)
    assert f"{count} frames, only {count - lost} show both markers" in sentence
    assert f"a score needs {MIN_FRAMES}" in sentence
    assert ("frame 0: the camera does not see marker 2" in sentence) == (lost > 0)


def test_the_command_scores_points_without_any_image(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(write_recording(tmp_path, 14)), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert len(report["frames"]) == 14 and report["one_step_rms"]["projection"]["r_px"] is not None
    assert report["lengths_mm"]["insertion_zero"]["rig_file"] == 0.0


def test_the_points_of_a_real_recording_have_the_score_of_its_images(tmp_path: Path) -> None:
    if not ARM_RECORDING.exists():
        pytest.skip("../shared/data/dvrk_two_balls is not here")
    rig = ["--rig", str(ROOT / "examples/davinci.toml")]
    assert main(["replay", str(ARM_RECORDING), *rig, "--out", str(tmp_path / "pictures")]) == 0
    poses = (ARM_RECORDING / "poses.csv").read_text().splitlines()
    centres = (tmp_path / "pictures" / "centres.csv").read_text().splitlines()
    (tmp_path / "points").mkdir()
    lines = [
        f"{pose},{centre.partition(',')[2]}" for pose, centre in zip(poses, centres, strict=True)
    ]
    (tmp_path / "points" / "poses.csv").write_text("\n".join(lines) + "\n")
    assert main(["replay", str(tmp_path / "points"), *rig, "--out", str(tmp_path / "again")]) == 0
    one, two = (
        json.loads((tmp_path / name / "replay.json").read_text()) for name in ("pictures", "again")
    )
    assert error_values(two["one_step_rms"]) == pytest.approx(
        error_values(one["one_step_rms"]), rel=0.01
    )


def error_values(rows: dict[str, dict[str, float]]) -> list[float]:
    """Return all errors but those of `affine`, which points without sizes do not update."""
    names = [name for name in rows if not name.startswith("affine")]
    return [value for name in names for value in rows[name].values()]
