"""Every estimator, built in or a user's own, in `rs.run`, in a replay and in the commands."""

import importlib
import pickle
from pathlib import Path

import numpy as np
import pytest

import rcmservo as rs
from conftest import ROOT, mark_others_slow
from rcmservo.cli.cli import main, parse_command_options
from rcmservo.config.class_registry import ESTIMATORS
from rcmservo.loop.plant import Plant

OWN = "lab_with_estimator:RLS"
SETTINGS = {"flow": rs.FlowEstimator(gamma=0.01)}
"""Settings of an estimator that learns nothing in a short exploration with its default ones."""

NEEDS_IMAGES = ("affine",)
"""Estimators that use the apparent sizes of the markers."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a folder with a module that holds the example's estimator."""
    source = (ROOT / "examples/02_own_estimator.py").read_text()
    (tmp_path / "lab_with_estimator.py").write_text(source)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def make_estimator(name: str) -> rs.Estimator:
    if name == OWN:
        return importlib.import_module("lab_with_estimator").RLS()
    return SETTINGS.get(name) or ESTIMATORS[name]()


@pytest.mark.parametrize("name", mark_others_slow([OWN, *ESTIMATORS]))
@pytest.mark.usefixtures("blank_figures")
def test_a_run_moves_to_the_target_and_its_record_replays(name: str, here: Path) -> None:
    rig = rs.sim.Rig(1, pictures=name in NEEDS_IMAGES)
    target = rig.teach(30)
    start_mm = rig.measure_true_error(target)
    result = rs.run(rig, rs.Servo(estimator=make_estimator(name)), target, 4.0, record="run")
    assert result.explore.time_s is not None, result.cause
    assert result.pose_error_mm is not None and result.pose_error_mm < 0.7 * start_mm
    assert main(["replay", "run", *(["--estimator", name] if name == OWN else [])]) == 0


@pytest.mark.parametrize(
    ("command", "name"),
    [("run", OWN), ("live", OWN), ("serve", OWN), *(("live", name) for name in ESTIMATORS)],
)
@pytest.mark.usefixtures("here")
def test_every_command_sends_the_estimator_to_its_servo_process(command: str, name: str) -> None:
    options = parse_command_options(command, ["--estimator", name])
    servo = pickle.loads(pickle.dumps(options.servo))
    assert type(servo.estimator) is type(make_estimator(name))
    rig = rs.sim.Rig(1, pictures=False)
    plant = Plant(rig.arm, rig.camera, rig.tracker, rig.clock)
    state = servo.step(servo.init(), plant.read(), rs.Target(np.ones((2, 2)), np.ones(3)))
    assert state.phase is not rs.Phase.FAULT
