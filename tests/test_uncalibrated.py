"""Uncalibrated: motion decisions cannot reach the true camera, and are the same without it."""

import os
import pickle
import re
import shutil
import subprocess
import sys

import pytest

from conftest import CONTROLLERS, ESTIMATORS, ROOT, TOOLS, make_laboratory
from rcmservo.safety.state_machine import Phase

LINT_PROGRAM = (
    "import sys; from importlinter.cli import lint_imports; "
    "sys.exit(lint_imports(no_cache=True, no_logo=True))"
)


def check_import_contracts(folder):
    """Check the import contracts of pyproject.toml on folder/src; return exit code and report."""
    path = os.pathsep.join([str(folder / "src"), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path, "COLUMNS": "300"}
    done = subprocess.run(
        [sys.executable, "-c", LINT_PROGRAM],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


def test_the_import_contracts_hold():
    code, report = check_import_contracts(ROOT)
    assert code == 0, report
    assert "0 broken" in report


FORBIDDEN_IMPORTS = [
    ("geometry.features", "rcmservo.sim.ground_truth", "Uncalibrated"),
    ("estimation.flow_rule", "rcmservo.sim", "Uncalibrated"),
    ("safety.gate", "rcmservo.paper.stability_claims", "Uncalibrated"),
    ("recording.writer", "rcmservo.live.servo_process", "A later folder"),
    ("geometry.kinematics", "rcmservo.servo.servo", "A later folder"),
    ("tracking.full_search", "rcmservo.sim.camera_model", "A later folder"),
    ("servo.servo", "cv2", "OpenCV"),
    ("sim.rendering.renderer", "cv2", "OpenCV"),
    ("tracking.ball_fit", "mujoco", "MuJoCo"),
    ("sim.scene", "matplotlib", "Matplotlib"),
]
"""Modules, what they must not import, and the contract that says so."""


def test_the_contracts_find_every_forbidden_import_and_an_unlisted_folder(tmp_path):
    shutil.copytree(
        ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
    )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    package = tmp_path / "src/rcmservo"
    for module, forbidden, _ in FORBIDDEN_IMPORTS:
        with (package / f"{module.replace('.', '/')}.py").open("a", encoding="utf-8") as file:
            file.write(f"\nimport {forbidden}\n")
    (package / "new_room.py").touch()
    code, report = check_import_contracts(tmp_path)
    assert code != 0
    sections = re.split(r"\n(?=.+\n-{20,}\n)", report.partition("\nBroken contracts\n")[2])
    for module, forbidden, contract in FORBIDDEN_IMPORTS:
        (section,) = (text for text in sections if text.startswith(contract))
        assert re.search(rf"rcmservo\.{module} -> {forbidden} \(l\.", section), report
    assert re.search(r"not listed as layers:\n+- rcmservo\.new_room\n", report)


PROGRAM_WITHOUT_SIMULATION = """
import pickle, sys

class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[:2] == ["rcmservo", "sim"] or name.split(".")[0] == "mujoco":
            raise ImportError(name + " is hidden in this process")

sys.meta_path.insert(0, Hide())
try:
    import rcmservo.sim
    sys.exit("the simulation is not hidden")
except ImportError:
    pass

with open(sys.argv[1], "rb") as file:
    servo, stream, target = pickle.load(file)
state, commands = servo.init(), []
for observation in stream:
    state = servo.step(state, observation, target)
    commands.append(state.command)
with open(sys.argv[2], "wb") as file:
    pickle.dump([(c.number, c.time, c.rates.tobytes()) for c in commands], file)
"""


@pytest.mark.parametrize(
    "estimator,tool,controller",
    [
        ("fast", "rigid", "continuous"),
        pytest.param("printed", "scaled", "printed", marks=pytest.mark.slow),
        pytest.param("flow", "rigid", "continuous", marks=pytest.mark.slow),
    ],
)
def test_without_the_simulation_the_same_observations_give_bitwise_equal_commands(
    tmp_path, estimator, tool, controller
):
    """Observations and servo carry no ground truth: a process without `rcmservo.sim` loads them."""
    lab = make_laboratory(seed=2)
    servo = lab.servo(
        estimator=ESTIMATORS[estimator], tool=TOOLS[tool], controller=CONTROLLERS[controller]
    )
    ticks = list(lab.run(servo, 4.0))
    expected = [
        (state.command.number, state.command.time, state.command.rates.tobytes())
        for _, state in ticks
    ]
    with (tmp_path / "stream").open("wb") as file:
        pickle.dump((servo, [observation for observation, _ in ticks], lab.target), file)
    subprocess.run(
        [
            sys.executable,
            "-c",
            PROGRAM_WITHOUT_SIMULATION,
            tmp_path / "stream",
            tmp_path / "commands",
        ],
        check=True,
    )
    with (tmp_path / "commands").open("rb") as file:
        assert pickle.load(file) == expected
    assert any(state.command.rates.any() for _, state in ticks)
    if estimator == "fast":
        assert any(state.phase is Phase.SERVO for _, state in ticks)


def test_the_core_loads_neither_camera_model_nor_physics_nor_pictures_nor_plots():
    code = (
        "import sys, rcmservo; print([m for m in ('rcmservo.sim', 'mujoco', 'cv2', "
        "'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
