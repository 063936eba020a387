"""Parts of the experiments: differentiation methods, estimators, endless explorations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT, SMALL_RIG_TOML
from rcmservo.cli.cli import main
from rcmservo.control.exploration import Exploration
from rcmservo.estimation.base import Sample
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.geometry.tool import RigidTool
from rcmservo.interfaces import Target
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.paper import differentiation_claims, regulation_projection_claims
from rcmservo.paper.camera_knowledge_claims import parameter_error, parameters_of
from rcmservo.paper.lab.cameras import PINHOLE
from rcmservo.paper.lab.closed_loop import make_servo
from rcmservo.paper.lab.evaluation import laboratory
from rcmservo.paper.lab.methods import DEFAULT
from rcmservo.paper.lab.paper_settings import (
    FAST_ESTIMATOR,
    FLOW_EXPLORATION,
    PROJECTION_EXPLORATION,
    remove_limits,
)
from rcmservo.paper.lab.random_observations import RandomObservations
from rcmservo.paper.plan import Settings
from rcmservo.recording.reader import read_record
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings, SceneSettings

SCENE = SceneSettings(room=17.0)
SEED = 3


def test_every_differentiation_method_gives_finite_results() -> None:
    settings = Settings(touring=differentiation_claims.JUDGED_S + 1.0, gamma=0.001)
    results = differentiation_claims.explore(settings, seed=0)
    for method in differentiation_claims.DIFFERENTIATION_METHODS:
        assert np.isfinite(list(results[method].values())).all()
    assert results["frame"]["ratio"] == pytest.approx(1.0, abs=0.05)
    assert results["stale"]["ratio"] == pytest.approx(0.6, abs=0.05)


def test_a_run_can_use_the_random_observations_of_the_paper(tmp_path: Path) -> None:
    """docs/paper.md states the name of the estimator."""
    name = f"{RandomObservations.__module__}:{RandomObservations.__name__}"
    assert f"--estimator {name}" in (ROOT / "docs/paper.md").read_text()
    (tmp_path / "rig.toml").write_text(SMALL_RIG_TOML)
    out = ["--duration", "1.1", "--no-video", "--json", "--out", str(tmp_path / "run")]
    out += ["--rig", str(tmp_path / "rig.toml")]
    options = ["--random.observations", "12", "--teaching-frames", "5", *out]
    assert main(["run", "--estimator", name, *options]) == 1
    (stage,) = read_record(tmp_path / "run").stages
    expected = {"kind": name, "observations": 12, "estimator_time": 1e4}
    assert stage.servo["estimator"] == expected


def test_random_observations_are_uniform_over_time() -> None:
    estimator, tool = RandomObservations(observations=10), RigidTool(30.0)
    memory, count = estimator.init(), 400
    for k in range(count):
        p1 = np.array([float(k), 10.0, 100.0])
        memory = estimator.update(memory, tool, Sample(p1, np.zeros((2, 2)), np.zeros(2), 0.016))
    indices = memory.observations[:, 0]
    assert len(set(indices)) == 10
    assert 0.2 * count < np.mean(indices) < 0.8 * count
    assert np.min(indices) < 0.5 * count < np.max(indices)


def test_the_default_method_is_the_default_servo_and_its_name_states_the_gain() -> None:
    plain = Servo(SphericalRcm(), RigidTool(30.0))
    assert DEFAULT.estimator == plain.estimator
    assert DEFAULT.exploration == plain.exploration
    assert DEFAULT.controller == replace(plain.controller, joint_trust=0.0)  # image alone
    defaults = regulation_projection_claims.make_default_plan(Settings(default_duration=25.0))
    assert defaults.servo.controller == plain.controller
    assert defaults.estimator == plain.estimator
    assert defaults.exploration == plain.exploration
    assert f"k = {plain.controller.gain:g})" in DEFAULT.name


def test_the_fit_of_the_projection_gives_the_parameters_of_the_paper() -> None:
    rig = Rig(0, RigSettings(scene=PINHOLE), pictures=False)
    estimator, tool = DltEstimator(), rig.settings.tool
    start, memory = rig.body.points(rig.scene.start)[0], estimator.init()
    for offset in np.random.default_rng(0).uniform(-10.0, 10.0, (40, 3)):
        q = rig.body.mechanism.joints(start + offset)
        sample = Sample(start + offset, rig.truth.pixels(q), np.zeros(2), 0.016)
        memory = estimator.update(memory, tool, sample)
    assert parameter_error(rig, parameters_of(estimator, memory)) < 1e-3


@pytest.mark.parametrize("exploration", [PROJECTION_EXPLORATION, FLOW_EXPLORATION])
def test_an_endless_exploration_continues_in_equal_rounds(exploration: Exploration) -> None:
    """The distance from the start is about the reach of the exploration in each round."""
    rig, plant = laboratory(SEED, SCENE, 0.1)
    servo = make_servo(rig.settings, FAST_ESTIMATOR, remove_limits(exploration))
    here = Target(rig.truth.pixels(rig.scene.start), rig.scene.start)
    distances = list[float]()
    start = rig.body.points(rig.arm.q_true)[0]
    for tick in servo_ticks(plant, servo, here, 12.0):
        assert not tick.state.explored and not tick.state.cause.stop_sentence
        distances.append(float(np.linalg.norm(rig.body.points(rig.arm.q_true)[0] - start)))
    middle = len(distances) // 2
    for half in (distances[:middle], distances[middle:]):
        assert 0.6 * exploration.max_leg_length < max(half) < 1.1 * exploration.max_leg_length
