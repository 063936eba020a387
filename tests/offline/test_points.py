"""A recording of points is scored like one of pictures, and one that is too short says so."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from conftest import DATA, ROOT, markers_seen, random_from, true_camera
from rcmservo.app.cli import main
from rcmservo.config.rig_file import Lab
from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Floats
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.imaged_rcm import ImagedRcm, solve
from rcmservo.method.tool import Tool
from rcmservo.offline.frames_folder import POINT_COLUMNS, load
from rcmservo.offline.score import ENOUGH, STILL_SPEED, Replay, replay
from rcmservo.tracking import PointMarkers

LAB = Lab()


def recorded(folder: Path, count: int, lost: int = 0) -> Path:
    """A recording of points by an exact camera; in the first `lost` frames marker 2 is not seen."""
    random = random_from(5)
    low, high = np.array([0.5, -0.6, 90.0]), np.array([0.9, 0.6, 150.0])
    joints = random.uniform(low, high, (count, 3))
    places = np.array([LAB.mechanism.position(q) for q in joints])
    C = true_camera(random_from(8), places)
    lines = ["frame,theta_rad,phi_rad,rho_m," + ",".join(POINT_COLUMNS)]
    for i, (q, p1) in enumerate(zip(joints, places, strict=True)):
        points = [f"{x:.9f}" for x in markers_seen(C, p1).ravel()]
        points[2:] = ["", ""] if i < lost else points[2:]
        lines.append(",".join([str(i), *(repr(float(x)) for x in q * [1, 1, 1e-3]), *points]))
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    return folder


def score(folder: Path) -> Replay:
    estimators = {"projection": ProjectionEstimator(rate=20.0)}
    return replay(folder, LAB, PointMarkers(), estimators, ImagedRcm())


def test_of_exact_points_the_estimate_predicts_a_small_share_of_the_motion(tmp_path: Path) -> None:
    result = score(recorded(tmp_path, 40))
    still, ours = result.one_step["no_motion"], result.one_step["projection"]
    assert np.all(ours < 0.05 * still)
    assert np.all(result.reprojection < 0.05 * still[1])


def test_a_score_can_be_of_eq_16_as_printed(tmp_path: Path) -> None:
    """Over the last lines: those of the last frames."""
    estimators = {"projection": ProjectionEstimator(rate=20.0)}
    printed = ImagedRcm(lines=4, fit="printed", max_condition=1e12)
    result = replay(recorded(tmp_path, 40), LAB, PointMarkers(), estimators, printed)
    last = np.array([found.points.ravel() for found in result.markers[-4:]])
    assert np.array_equal(result.o_c, solve(last, 4, 0, True)[0])


def test_frames_that_miss_a_marker_are_left_out(tmp_path: Path) -> None:
    result = score(recorded(tmp_path, ENOUGH + 3, lost=3))
    assert sum(np.isfinite(found.points).all() for found in result.markers) == ENOUGH
    assert np.isfinite(result.one_step["projection"]).all()


class Noting(Estimator):
    """Learns nothing but how much time has gone between its samples."""

    def init(self) -> list[float]:
        return []

    def update(self, memory: list[float], tool: Tool, sample: Sample) -> list[float]:
        return [*memory, sample.dt]

    def jacobian(self, memory: list[float], tool: Tool, sample: Sample) -> Floats:
        noted.append(memory)
        return np.zeros((3, 3))


noted: list[list[float]] = []


def test_an_estimator_is_told_the_time_since_it_learnt_last(tmp_path: Path) -> None:
    """0 at first; and no time is lost with the frames after which o_c is not known."""
    folder = recorded(tmp_path, 20)
    noted.clear()
    replay(folder, LAB, PointMarkers(), {"noting": Noting()}, ImagedRcm(max_condition=17.0))
    poses = load(folder, LAB.mechanism, LAB.tool)
    ways = [np.linalg.norm(b.p1 - a.p1) for a, b in itertools.pairwise(poses)]
    moments = np.cumsum(ways) / STILL_SPEED
    first, *others = noted[-1]
    learnt = moments[0] + np.cumsum(others)
    nearest = np.abs(moments[:, None] - learnt).argmin(axis=0)
    assert first == 0.0 and moments[nearest] == pytest.approx(learnt)
    assert np.diff(nearest).max() > 1, "some frames were left out"


@pytest.mark.parametrize(("count", "lost"), [(3, 0), (ENOUGH - 1, 0), (ENOUGH + 3, 4)])
def test_too_few_frames_are_told(count: int, lost: int, tmp_path: Path) -> None:
    with pytest.raises(UnusableFile) as caught:
        score(recorded(tmp_path, count, lost))
    sentence = str(caught.value)
    assert f"{count} frames, only {count - lost} show both markers" in sentence
    assert f"a score takes {ENOUGH}" in sentence
    assert ("frame 0: the camera does not see marker 2" in sentence) == (lost > 0)


def test_the_command_scores_points_without_any_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(recorded(tmp_path, 14)), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert len(report["frames"]) == 14 and report["one_step_rms"]["projection"]["r_px"] is not None


def test_the_points_found_in_a_real_recording_get_its_score(tmp_path: Path) -> None:
    if not DATA.exists():
        pytest.skip("../shared/data/dvrk_two_balls is not here")
    rig = ["--rig", str(ROOT / "examples/davinci.toml")]
    assert main(["replay", str(DATA), *rig, "--out", str(tmp_path / "pictures")]) == 0
    poses = (DATA / "poses.csv").read_text().splitlines()
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
    assert rounded(two["one_step_rms"]) == pytest.approx(rounded(one["one_step_rms"]), rel=0.01)


def rounded(rows: dict[str, dict[str, float]]) -> list[float]:
    """All errors but those of `affine`, which points without sizes teach nothing."""
    names = [name for name in rows if not name.startswith("affine")]
    return [value for name in names for value in rows[name].values()]
