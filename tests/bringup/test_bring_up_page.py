"""docs/bring_up.md: its commands are commands, its rig file is one, and its tutorial answers the
questions that are asked in it."""

import re
import shlex
from pathlib import Path

import pytest
from rig_check_lab import Mistake, WrongLab

from bring_up_page import PAGE, answer_to
from conftest import first_quick
from rcmservo.app.cli import COMMANDS
from rcmservo.app.lab.emulate import COUNTS, EmulateOptions
from rcmservo.app.lab.emulated_arm import EmulatedArm
from rcmservo.app.lab.markers import MarkersOptions
from rcmservo.app.lab.rig_check import RigOptions
from rcmservo.app.live import LiveOptions
from rcmservo.app.parse import parse
from rcmservo.config.rig_file import Lab, load_lab
from rcmservo.hardware.devices import ARMS, CAMERAS, wiring_of

SEED = int(re.search(r"--seed (\d+)", PAGE)[1])  # type: ignore[index]
"""Of the page's laboratory."""


def test_every_command_of_the_page_can_be_read() -> None:
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
    lines = [line for block in blocks for line in block.splitlines()]
    options = {name: kind for name, (kind, _) in COMMANDS.items()}
    read = [parse(options, shlex.split(line)[1:]) for line in lines]
    assert [type(one) for one in read] == [
        EmulateOptions,
        MarkersOptions,
        RigOptions,
        LiveOptions,
    ]


def test_the_rig_file_of_the_page_is_that_of_the_emulated_laboratory(tmp_path: Path) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
    path = tmp_path / "lab.toml"
    path.write_text(block)
    lab = load_lab(path)
    assert wiring_of(lab).counts == COUNTS
    assert lab.device("arm", ARMS).port == 2323
    assert "8080" in lab.device("camera", CAMERAS).source


def test_the_check_passes_with_the_answers_of_the_page() -> None:
    """In simulated time; tests/live asks the command itself."""
    with EmulatedArm(SEED, Lab()) as arm:
        printed = arm.measurements
    lab = WrongLab(Mistake(), SEED, Lab().mechanism)
    lab.person.instead = lambda asked: answer_to(asked, printed)
    report = lab.check()
    assert report.ok, report.findings
    assert any("which way" in asked for asked in lab.person.asked)


@pytest.mark.parametrize("seed", first_quick([SEED, 0, 1]))
def test_the_answers_of_the_page_are_true_of_every_question(seed: int) -> None:
    """Of those too that the page's laboratory is not asked: a mistake has more of them asked."""
    with EmulatedArm(seed, Lab()) as arm:
        printed = arm.measurements
    lab = WrongLab(Mistake(spacing=1.25), seed, Lab().mechanism)
    lab.person.instead = lambda asked: answer_to(asked, printed)
    report = lab.check()
    assert any("how far apart" in asked for asked in lab.person.asked)
    assert [one.where for one in report.findings] == ["tool.spacing"]
