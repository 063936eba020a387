"""The example with PyBullet: its iiwa arrives, and software holds the tool in the port."""

import importlib
import os
import platform
import re
import subprocess
import sys
from importlib.machinery import PathFinder
from typing import Any

import numpy as np
import pytest

from conftest import ROOT
from peers import mark_peer
from rcmservo.interfaces import Command

EXAMPLE = ROOT / "examples/pybullet_iiwa.py"
PEERS = ROOT / ".peers"

MAX_LINES = 120

MAX_PORT_DEVIATION_M = 1e-4
"""Largest distance of the shaft's axis from the port during a motion."""

IS_INSTALLED = PathFinder.find_spec("pybullet", [*sys.path, str(PEERS)]) is not None
HAS_WHEEL = sys.version_info < (3, 12) and (sys.platform, platform.machine()) == ("linux", "x86_64")

pybullet = (
    mark_peer("PyBullet", IS_INSTALLED, "make peers")
    if IS_INSTALLED or HAS_WHEEL
    else pytest.mark.skip(f"PyBullet has no wheel for Python {platform.python_version()} here")
)


@pytest.fixture(scope="module")
def example() -> Any:
    """Module of the example."""
    added = [str(PEERS), str(EXAMPLE.parent)]
    sys.path.extend(added)
    yield importlib.import_module(EXAMPLE.stem)
    for folder in added:
        sys.path.remove(folder)


def test_the_example_has_at_most_120_lines() -> None:
    assert len(EXAMPLE.read_text().splitlines()) <= MAX_LINES


@pybullet
@pytest.mark.slow
def test_the_iiwa_arrives_within_1_mm() -> None:
    path = os.pathsep.join([*filter(None, [os.environ.get("PYTHONPATH")]), str(PEERS)])
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), "1"],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    line = r"^seed (\d): (\d+\.\d\d) mm from the target; arrived, .*$"
    ((seed, error_mm),) = re.findall(line, done.stdout, re.M)
    assert seed == "0" and float(error_mm) < 1.0
    assert re.search(r"^1 of 1 within 1 mm, median 0\.\d\d mm$", done.stdout, re.M)


@pybullet
@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 9])
def test_without_antialiasing_it_arrives_too(
    example: Any, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The markers then scatter more than the tracker reports."""
    monkeypatch.setattr(example, "SAMPLES", example.IMAGE_PX)
    assert example.run_seed(seed) < 1.0


@pybullet
@pytest.mark.slow
def test_the_shaft_stays_in_the_port_while_the_tool_follows_its_joint_rates(example: Any) -> None:
    lab, q, rates = example.IiwaLab(example.EYE), np.array([0.2, -0.1, 100.0]), (0.2, -0.3, 20.0)
    lab.place(q)
    assert lab.measure().q == pytest.approx(q, abs=1e-3)
    lab.enable()
    for number in range(100):
        lab.apply(Command(number, lab.now(), lab.now() + 50_000_000, np.array(rates), True))
        lab.wait_until(lab.now() + 10_000_000)
        assert measure_port_deviation(example, lab) < MAX_PORT_DEVIATION_M
    lab.wait_until(lab.now() + 1_000_000_000)  # the watchdog stops the drive after 50 ms
    measured = lab.measure()
    assert not measured.enabled
    travelled = 1.0 + 0.05
    assert measured.q == pytest.approx(q + np.array(rates) * travelled, rel=0.02)


def measure_port_deviation(example: Any, lab: Any) -> float:
    """Return the distance in m of the shaft's axis from the port, by PyBullet's state."""
    flange, ball = (np.array(lab.tool_pose(distance)[0]) for distance in (0.0, example.BALL_1))
    axis = (ball - flange) / example.BALL_1
    return float(np.linalg.norm(np.cross(example.PORT - flange, axis)))
