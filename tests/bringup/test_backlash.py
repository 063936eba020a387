"""`rig check` on arms with backlash: its size, and the mistakes of the rig file in spite of it."""

import numpy as np
import pytest
from rig_check_lab import MAX_TRAVEL_MM, MISTAKES, FaultyLab, Mistake

from conftest import mark_others_slow
from rcmservo.bringup.approach_direction import find_directions, find_known_views
from rcmservo.bringup.check import CheckReport
from rcmservo.bringup.observations import JointMotion, StillView
from rcmservo.cli.lab.rig_check import list_measurements
from rcmservo.constraints import Triple
from rcmservo.geometry.kinematics import PitchYawRcm, SphericalRcm
from rcmservo.sim import Imperfections, RigSettings

NONE: Triple = (0.0, 0.0, 0.0)
LARGE: Triple = (0.0052, 0.0052, 0.2)
"""Backlash of 0.3 degrees, 0.3 degrees and 0.2 mm."""
RIGHT_FILES = [(LARGE, 1), (NONE, 1), (LARGE, 0), (NONE, 0), ((0.0007, 0.0026, 0.05), 2)]
"""Backlash and seeds; the mechanism is spherical if the seed is even."""
MISTAKEN_FILES = [
    ("counts of 3 halved", 1),
    ("joint 2 reversed", 0),
    ("axes 1 and 2 swapped", 1),
    ("spacing", 2),
    ("insertion zero", 3),
]
"""Mistakes and seeds."""


def run_check(mistake: Mistake, backlash: Triple, seed: int) -> tuple[FaultyLab, CheckReport]:
    mechanism = SphericalRcm() if seed % 2 == 0 else PitchYawRcm()
    imperfections = Imperfections(backlash=backlash)
    settings = RigSettings(mechanism=mechanism, imperfections=imperfections)
    lab = FaultyLab(mistake, seed, settings=settings)
    return lab, lab.check()


@pytest.mark.parametrize("case", mark_others_slow(RIGHT_FILES))
def test_a_right_rig_file_passes_and_the_backlash_of_each_joint_is_measured(
    case: tuple[Triple, int],
) -> None:
    backlash, seed = case
    lab, report = run_check(Mistake(), backlash, seed)
    assert report.ok, report.findings
    assert lab.arm.max_travel < MAX_TRAVEL_MM
    for found, true in zip(report.backlash, backlash, strict=True):
        assert abs(found.size - true) < max(4.0 * found.deviation, 0.1 * true)
        assert found.is_measured == (true > 0.0)
        assert found.repeatability < 4.0 * found.deviation
    rows = dict(list_measurements(report, lab.robot))
    (lines,) = (text for name, text in rows.items() if "simulation" in name)
    assert "[imperfections]" in lines and ("backlash = [0, 0, 0]" in lines) == (not any(backlash))


@pytest.mark.parametrize("case", mark_others_slow(MISTAKEN_FILES))
def test_a_mistake_is_found_on_an_arm_with_backlash(case: tuple[str, int]) -> None:
    name, seed = case
    lab, report = run_check(MISTAKES[name], (0.0026, 0.0026, 0.1), seed)
    assert MISTAKES[name].is_found(report), report.findings
    assert lab.arm.max_travel < MAX_TRAVEL_MM


def move_joints(backlash: float, sizes: list[float]) -> list[JointMotion]:
    """Return motions of all joints in mm, each with the same backlash, at 10 px per mm."""
    rng, motions, tool = np.random.default_rng(0), list[JointMotion](), np.full(3, 0.5 * backlash)
    for size in sizes:
        for joint in range(3):
            views = list[StillView]()
            for motor in (size, -size, 0.0):
                tool[joint] = np.clip(tool[joint], motor, motor + backlash)
                points = 10.0 * np.append(tool, 1.0).reshape(2, 2) + rng.normal(0.0, 0.03, (2, 2))
                views.append(StillView(motor * np.eye(3)[joint], points, 0.23, 60, 0))
            motions.append(JointMotion(joint, size, views))
    return motions


def test_views_count_after_all_joints_have_taken_up_their_backlash_and_moved_again() -> None:
    small, large, again = [0.1, 0.2, 0.4], [0.1, 0.2, 0.4, 0.8], [0.1, 0.2, 0.4, 0.8, 0.8]
    assert find_known_views(move_joints(0.5, small)) is None
    assert find_known_views(move_joints(0.5, large)) is None
    assert find_known_views(move_joints(0.5, again)) == 36
    assert find_known_views(move_joints(0.0, small)) == 0


def test_a_joint_has_come_from_above_until_it_moves_up() -> None:
    first, second, _ = move_joints(0.5, [1.0])
    returned = JointMotion(0, 1.0, first.views[::2])
    directions = find_directions([returned, second, first])
    assert directions[:, 0].tolist() == [0, 0, 1, 1, 1, 1, 0, 1, 0]
    assert directions[:, 1].tolist() == [0, 0, 0, 0, 1, 0, 0, 0, 0]
