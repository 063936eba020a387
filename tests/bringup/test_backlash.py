"""Backlash of each joint by `rig check`, against that of the simulated arm."""

import numpy as np
import pytest
from rig_check_lab import FaultyLab, Mistake

from rcmservo.bringup.check import CheckReport
from rcmservo.cli.lab.rig_check import list_measurements
from rcmservo.constraints import Triple
from rcmservo.sim import Imperfections, RigSettings

SIZES = [(0.0, 0.0, 0.0), (0.0044, 0.0026, 0.2)]
"""None; a quarter of a degree, 0.15 degrees, and 0.2 mm."""


def run_check(backlash: Triple) -> tuple[FaultyLab, CheckReport]:
    settings = RigSettings(imperfections=Imperfections(backlash=backlash))
    lab = FaultyLab(Mistake(), 0, settings=settings)
    return lab, lab.check()


@pytest.mark.parametrize("backlash", SIZES)
def test_the_backlash_of_each_joint_is_measured(backlash: Triple) -> None:
    lab, report = run_check(backlash)
    assert report.ok, report.findings
    for found, true in zip(report.backlash, backlash, strict=True):
        assert abs(found.size - true) < max(4.0 * found.deviation, 0.1 * true)
        assert found.is_measured == (true > 0.0)
        assert found.repeatability < 4.0 * found.deviation
    rows = dict(list_measurements(report, lab.robot))
    (lines,) = (text for name, text in rows.items() if "simulation" in name)
    assert "[imperfections]" in lines and ("backlash = [0, 0, 0]" in lines) == (not any(backlash))
    assert np.linalg.norm(lab.arm.q_true - lab.arm.rig.truth.arm.q_motor) <= np.linalg.norm(
        backlash
    )
