"""Number of frames over which a target is averaged: one default and one option."""

from collections.abc import Callable
from inspect import signature
from typing import Any, cast

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.cli.cli import main
from rcmservo.cli.lab import hardware_prompts
from rcmservo.cli.lab.hardware_prompts import HardwarePreparation
from rcmservo.cli.lab.serve import ServeOptions
from rcmservo.cli.live import LiveOptions
from rcmservo.cli.run_description import describe_simulated_run
from rcmservo.cli.run_options import RunOptions
from rcmservo.cli.simulated_run.target import obtain_target
from rcmservo.live.arm_datagrams import teach_and_return
from rcmservo.loop.operator import Teach
from rcmservo.loop.plant import Plant
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.page.operator import PageOperator
from rcmservo.sim import Rig, RigSettings
from rcmservo.sim.processes.lab_processes import SimulatedLab
from rcmservo.sim.scripted_operator import ScriptedOperator
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.simulation_engine import SimulationEngine
from rcmservo.tracking import PointMarkers

FRAME_PARAMETERS: dict[Callable[..., object], str] = {
    rs.teach: "frames",
    Teach: "frames",
    CompiledEngine: "teaching_frames",
    SimulationEngine: "teaching_frames",
    StudyPlan: "teaching_frames",
    ScriptedOperator: "frames",
    teach_and_return: "frames",
    SimulatedLab.session: "frames",
    HardwarePreparation: "teaching_frames",
    PageOperator: "frames",
    RunOptions: "teaching_frames",
    LiveOptions: "teaching_frames",
    ServeOptions: "teaching_frames",
}
"""Functions and classes that teach, and the names of their parameters for the number of frames."""


def test_every_way_of_teaching_uses_the_accurate_number_of_frames() -> None:
    """Five seconds at 60 frames/s, as docs/how_to_choose.md advises."""
    defaults = {
        made: signature(made).parameters[name].default for made, name in FRAME_PARAMETERS.items()
    }
    assert set(defaults.values()) == {TEACHING_FRAMES} == {300}


@pytest.mark.parametrize("command", ["run", "live", "serve"])
@pytest.mark.parametrize("frames", ["0", "-1", "100001"])
def test_an_invalid_number_of_frames_is_refused(
    command: str, frames: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, "--teaching-frames", frames]) == 2
    message = capsys.readouterr().err
    assert "--teaching-frames must be a whole number from 1 to 100000 frames" in message


def test_a_simulated_run_teaches_with_the_requested_number_of_frames() -> None:
    rig = Rig(0, RigSettings(), pictures=False)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    took = list[float]()
    for frames in (30, 60):
        began = rig.clock.now()
        obtain_target(RunOptions(teaching_frames=frames), rig, plant)
        took.append((rig.clock.now() - began) * 1e-9)
    assert took[1] - took[0] == pytest.approx(0.5, abs=0.1)
    assert describe_simulated_run(RunOptions(teaching_frames=7), 2.0)["teaching_frames"] == 7


def test_a_target_taught_at_the_arm_averages_the_requested_frames(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    numbers, printed = list[int](), list[str]()
    taught = rs.Target(np.array([[1.0, 2.0], [30.0, 40.0]]), np.zeros(3), left_out=2)

    def teach(plant: Any, frames: int) -> rs.Target:
        numbers.append(frames)
        return taught

    monkeypatch.setattr(hardware_prompts, "await_enter", lambda *_: None)
    monkeypatch.setattr(hardware_prompts, "teach", teach)
    operator: Any = type("Operator", (), {"notify": lambda self, words: printed.append(words)})()
    assert hardware_prompts.teach_by_hand(operator, cast(Any, None), 7) is taught
    assert numbers == [7] and printed[0].startswith("Averaging 7 frames")
    assert "2 frames were left out" in printed[1]
