"""docs/own_devices.md: clock and arm of a user's own simulator, and the rig file of own devices."""

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import ROOT
from rcmservo.config.rig_file import load_rig_file
from rcmservo.hardware.lab_rig import require_devices
from rcmservo.interfaces import Floats

PAGE = (ROOT / "docs/own_devices.md").read_text()
STEP_NS, LAG_S = 2_000_000, 0.069
START, GOAL = np.array([0.6, 0.2, 120.0]), np.array([0.7, 0.35, 130.0])
MECHANISM, TOOL = rs.SphericalRcm(), rs.RigidTool(30.0)


def load_example() -> dict[str, Any]:
    """Return what the page's example in simulated time defines."""
    text = PAGE.split("## A robot or a simulator of another kind\n")[1]
    names: dict[str, Any] = {}
    exec(re.findall(r"```python\n(.*?)```", text, re.S)[0], names)
    return names


class LaggingRobot:
    """Robot whose tool point follows its setpoint with a first-order lag."""

    def __init__(self) -> None:
        self.point = self.setpoint = MECHANISM.position(START)

    def tool_point(self) -> Floats:
        return self.point.copy()

    def move_tool_to(self, point: Floats) -> None:
        self.setpoint = point

    def step(self) -> None:
        self.point = self.point + (self.setpoint - self.point) * STEP_NS * 1e-9 / LAG_S


class PinholeCamera:
    """Projection of the markers by a camera 350 mm from the start."""

    def __init__(self) -> None:
        middle = MECHANISM.position(START)
        self.position = middle + 350.0 * np.array([-0.7, -0.6, -0.2])
        forward = (middle - self.position) / np.linalg.norm(middle - self.position)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self.rotation = np.stack([right, np.cross(forward, right), forward])

    def project(self, p1: Floats) -> Floats:
        markers = np.stack([p1, p1 * (1.0 + 30.0 / np.linalg.norm(p1))])
        x, y, z = self.rotation @ (markers - self.position).T
        return np.stack([800.0 * x / z + 320.0, 800.0 * y / z + 240.0], axis=1)


def make_simulator() -> tuple[LaggingRobot, Any, Any, Any]:
    """Return robot, clock, arm and camera of the page's example."""
    example, robot = load_example(), LaggingRobot()

    def step() -> None:
        arm.move()
        robot.step()

    clock = example["SimulatorClock"](step, STEP_NS)
    arm = example["PortArm"](robot, clock, MECHANISM)
    camera = example["PointCamera"](robot, clock, PinholeCamera().project)
    return robot, clock, arm, camera


def test_a_servo_reaches_the_target_on_the_simulator_of_the_page() -> None:
    """The robot lags by 69 ms: with rates at the measured pose, the tool would leave the path."""
    robot, clock, arm, camera = make_simulator()
    rig = rs.Rig(arm, camera, rs.tracking.PointMarkers(), MECHANISM, TOOL, clock)
    rig.is_simulated = True
    robot.point = robot.setpoint = MECHANISM.position(GOAL)
    target = rig.teach(10)
    robot.point = robot.setpoint = MECHANISM.position(START)
    clock.wait_until(clock.now() + 50_000_000)
    result = rs.run(rig, rs.Servo(), target, 10.0)
    assert result.settled, result.cause
    assert np.linalg.norm(robot.point - MECHANISM.position(GOAL)) < 0.2


def test_the_arm_and_the_camera_of_the_page_keep_their_contracts() -> None:
    _, clock, arm, camera = make_simulator()
    rs.testing.check_camera(camera, clock)
    rs.testing.check_arm(arm, clock, may_move=True)


def test_the_rig_file_of_the_page_names_own_devices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The classes have the arguments that the page's keys are."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    (block,) = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
    (path := tmp_path / "lab.toml").write_text(block)
    (tmp_path / "my_lab.py").write_text(
        "class MyArm:\n"
        "    def __init__(self, address: str): ...\n"
        "    def enable(self): ...\n    def measure(self): ...\n    def apply(self, c): ...\n"
        "class MyCamera:\n    def latest(self): ...\n"
        "class MyTracker:\n"
        "    def __init__(self, contrast: float): ...\n"
        "    def find(self, frame): ...\n    def reset(self): ...\n"
    )
    require_devices(load_rig_file(path), path, "")
    assert sys.modules.pop("my_lab").__file__ == str(tmp_path / "my_lab.py")
