"""User-defined estimator and feature vector in the loop, options, record, page and study."""

import importlib
import json
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import SMALL_RIG_TOML, make_laboratory
from rcmservo.cli.cli import main
from rcmservo.control.feature_vectors import FEATURE_VECTORS
from rcmservo.loop.operator import check_changed_servo
from rcmservo.page.web.setting_fields import build_forms
from rcmservo.servo.user_features import check_feature_vector
from rcmservo.study.execution import workers as crews
from rcmservo.study.execution.chunk import run_chunk
from rcmservo.study.execution.store import read_runs

MODULE = "user_module"
ESTIMATOR = f"{MODULE}:Pixels"
SOURCE = """
from dataclasses import dataclass
import numpy as np
import rcmservo as rs
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm


@dataclass(frozen=True)
class Pixels(rs.Estimator):
    forgetting: float = 0.98
    \"\"\"Weight of earlier measurements.\"\"\"

    name = "pixels"

    def init(self):
        return np.zeros((4, 4)), 1e6 * np.eye(4), np.full(3, np.inf)

    def update(self, memory, tool, sample):
        A, P, last = memory
        if np.linalg.norm(sample.p1 - last) < 1.0:
            return memory
        x = np.append(sample.p1, 1.0)
        gain = P @ x / (self.forgetting + x @ P @ x)
        A = A + np.outer(sample.points.ravel() - A @ x, gain)
        return A, (P - np.outer(gain, P @ x)) / self.forgetting, sample.p1

    def markers_jacobian(self, memory, tool, sample):
        return memory[0][:, :3]

    def jacobian(self, memory, tool, sample):
        return compute_features_jacobian(shift_to_rcm(sample.points, sample.o_c)) @ memory[0][:, :3]


class Pose(rs.FeatureVector):
    name = "pose"
    components = ("angle", "u", "v", "length", "u1")
    units = ("rad", "px", "px", "px", "px")

    def measure(self, markers):
        (u1, v1), (u2, v2) = markers.points
        length = np.hypot(u2 - u1, v2 - v1)
        return np.array([np.arctan2(v2 - v1, u2 - u1), (u1 + u2) / 2, (v1 + v2) / 2, length, u1])

    def jacobian(self, markers):
        du, dv = markers.points[1] - markers.points[0]
        d = np.hypot(du, dv)
        turn, along = np.array([-dv, du]) / d**2, np.array([du, dv]) / d
        middle = [[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5]]
        return np.array([[*-turn, *turn], *middle, [*-along, *along], [1.0, 0.0, 0.0, 0.0]])


rs.add_feature_vector(Pose())
"""
STUDY = f"""
methods = ["mine"]
scenes = ["random"]
count = 1
duration = 2.0
[method.mine]
estimator = "{ESTIMATOR}"
controller = {{ features = "pose" }}
"""


@pytest.fixture
def user_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Any]:
    """Imported module of a user in the present folder."""
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    (tmp_path / "study.toml").write_text(STUDY)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    yield importlib.import_module(MODULE)
    del sys.modules[MODULE], FEATURE_VECTORS["pose"]


def ran(estimator: rs.Estimator, features: str) -> list[rs.State]:
    lab = make_laboratory(4)
    law = rs.SaturatedController(features=features)
    servo = rs.Servo(lab.rig.settings.mechanism, lab.rig.settings.tool, estimator, law)
    servo.warm_up()
    lab.rig.begin()
    return [state for _, state in lab.run(servo, 5.0)]


def test_the_law_on_a_user_defined_feature_vector_reaches_the_target(user_module: Any) -> None:
    for estimator, limit in ((rs.DltEstimator(), 0.2), (user_module.Pixels(), 2.0)):
        end = ran(estimator, "pose")[-1]
        assert end.phase is rs.Phase.SERVO and end.decision.remaining_mm < limit
        used = end.stored.estimate.controlled_jacobian.any(axis=1)
        assert used.tolist() == [True] * 5 + [False] * (len(used) - 5)


@pytest.mark.usefixtures("blank_figures")
def test_both_are_options_of_a_run_whose_record_replays_bit_for_bit(
    user_module: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    del user_module
    Path("rig.toml").write_text(SMALL_RIG_TOML)
    words = [
        "--rig",
        "rig.toml",
        "--estimator",
        ESTIMATOR,
        "--pixels.forgetting",
        "0.95",
        "--controller.features",
    ]
    words += ["pose", "--duration", "1.5", "--no-video", "--json", "--teaching-frames", "5"]
    assert main(["run", *words, "--out", "run"]) in (0, 1)
    assert json.loads(capsys.readouterr().out)["estimator"] == ESTIMATOR
    assert main(["replay", "run", "--json", "--estimator", ESTIMATOR]) == 0
    assert json.loads(capsys.readouterr().out)["same"]


def test_a_user_defined_feature_vector_is_a_choice_on_the_page(user_module: Any) -> None:
    del user_module
    form = next(
        form
        for form in build_forms(make_laboratory().servo(), None)
        if form["part"] == "controller"
    )
    fields = {field["name"]: field for field in form["kinds"]["saturated"]["fields"]}
    assert fields["features"]["choices"] == ["srd", "points", "size", "pose"]


class SingleWorker:
    """Workers of a study in this process."""

    count, where = 1, "this test"

    def run(self, orders: Any) -> Generator[Any]:
        for key, order in orders:
            yield key, run_chunk(order)


def test_both_take_part_in_a_study(user_module: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    del user_module

    @contextmanager
    def crew(address: str | None, workers: int | None) -> Generator[SingleWorker]:
        yield SingleWorker()

    monkeypatch.setattr(crews, "open_worker_pool", crew)
    assert main(["study", "study.toml", "--user-estimator", ESTIMATOR, "--out", "study"]) == 0
    (row,) = read_runs(Path("study")).to_pylist()
    assert (row["method"], row["engine"]) == ("mine", "mujoco")


@pytest.mark.parametrize("name", FEATURE_VECTORS)
def test_a_jacobian_is_the_derivative_of_the_features(name: str) -> None:
    check_feature_vector(FEATURE_VECTORS[name])


def test_a_false_jacobian_or_an_exception_is_refused_before_the_drive_is_enabled(
    user_module: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(user_module.Pose, "jacobian", lambda self, markers: np.ones((5, 4)))
    with pytest.raises(rs.BadInput, match="derivative of its measure"):
        ran(rs.DltEstimator(), "pose")
    monkeypatch.setattr(user_module.Pose, "measure", lambda self, markers: 1 / 0)
    with pytest.raises(rs.BadInput, match="ZeroDivisionError"):
        ran(rs.DltEstimator(), "pose")


def test_a_feature_vector_that_fails_in_motion_is_a_fault_in_the_same_tick(
    user_module: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, measure = [], user_module.Pose.measure

    def failing(self: Any, markers: rs.MarkerPair) -> Any:
        calls.append(markers)
        return measure(self, markers) if len(calls) < 200 else 1 / 0

    monkeypatch.setattr(user_module.Pose, "measure", failing)
    end = ran(rs.DltEstimator(), "pose")[-1]
    assert (end.phase, end.cause) == (rs.Phase.FAULT, rs.Cause.ESTIMATOR_FAILED)
    assert end.detail.startswith("feature vector pose raised ZeroDivisionError")
    assert not end.command.enabled


def test_a_jacobian_that_becomes_nan_in_motion_is_a_fault_and_no_silent_stop(
    user_module: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, jacobian = [], user_module.Pose.jacobian

    def failing(self: Any, markers: rs.MarkerPair) -> Any:
        calls.append(markers)
        return jacobian(self, markers) * (1.0 if len(calls) < 200 else np.nan)

    monkeypatch.setattr(user_module.Pose, "jacobian", failing)
    end = ran(rs.DltEstimator(), "pose")[-1]
    assert (end.phase, end.cause) == (rs.Phase.FAULT, rs.Cause.ESTIMATOR_FAILED)
    assert end.detail == "feature vector pose returned a Jacobian that is not finite"
    assert not end.command.enabled


@pytest.mark.parametrize("names", [("srd", "pose"), ("pose", "srd")])
@pytest.mark.usefixtures("user_module")
def test_during_a_run_compiled_and_python_feature_vectors_do_not_replace_each_other(
    names: tuple[str, str],
) -> None:
    lab = make_laboratory(4)
    before, after = (
        rs.Servo(
            lab.rig.settings.mechanism,
            lab.rig.settings.tool,
            controller=rs.SaturatedController(features=name),
        )
        for name in names
    )
    with pytest.raises(rs.BadInput, match=rf"servo.controller.features must be {names[0]} or"):
        check_changed_servo(before, after)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "srd"}, "a name that no other feature vector has"),
        ({"units": ("mm",) * 5}, "rad or px for each component"),
        ({"units": ("px",)}, "one for each of 1 to 8 components"),
    ],
)
def test_an_invalid_feature_vector_is_refused(
    change: dict[str, Any], words: str, user_module: Any
) -> None:
    other = type("Other", (user_module.Pose,), change)
    with pytest.raises(rs.BadInput, match=words):
        rs.add_feature_vector(other())
    with pytest.raises(rs.BadInput, match="derived from FeatureVector"):
        rs.add_feature_vector(3)
