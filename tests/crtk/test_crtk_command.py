"""Command `rcmservo emulate crtk`, run as a user runs it, with a rig file of its arm and camera."""

import contextlib
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from conftest import INTERRUPTIBLE_COMMAND, ROOT
from rcmservo.cli.cli import main
from rcmservo.config.rig_file import load_rig_file
from rcmservo.hardware.device_kinds import open_arm, open_camera

PAGE = (ROOT / "docs/crtk.md").read_text()
WORDS = "emulated CRTK arm PSM1 on ROS 2 (domain 96, lo), simulated arm, seed 3; Ctrl-C ends it\n"
SMALL = """
[camera]
width = 320
height = 240
"""


def code_blocks(language: str) -> list[str]:
    """Return the code blocks of the document."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def reached(condition: Callable[[], bool]) -> bool:
    """Wait for a condition; return False after 30 s."""
    end = time.monotonic() + 30.0
    while not condition():
        if time.monotonic() > end:
            return False
    return True


@pytest.mark.slow
@pytest.mark.alone
def test_the_command_prints_its_address_and_the_documents_rig_file_opens_arm_and_camera(
    tmp_path: Path,
) -> None:
    (command,) = (line for line in code_blocks("sh")[0].splitlines() if "emulate crtk" in line)
    arguments = command.split()[1:]
    small, lab = tmp_path / "small.toml", tmp_path / "lab.toml"
    small.write_text(SMALL)
    lab.write_text(
        code_blocks("toml")[0]
        .replace("[camera]", "[camera]\ndomain = 96")
        .replace("[arm]", "[arm]\ndomain = 96")
    )
    own = ["--domain", "96", "--seed", "3", "--rig", str(small)]
    start = [sys.executable, "-c", INTERRUPTIBLE_COMMAND, *arguments, *own]
    with subprocess.Popen(start, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as it:
        try:
            assert it.stdout is not None and it.stdout.readline() == WORDS
            rig_file = load_rig_file(lab)
            with (
                contextlib.closing(open_arm(rig_file)) as arm,
                contextlib.closing(open_camera(rig_file)) as camera,
            ):
                assert arm.is_homed() and not arm.measure().enabled
                assert reached(lambda: camera.latest() is not None), camera.counts()
                frame = camera.latest()
                assert frame is not None and frame.image is not None
                assert frame.image.shape == (240, 320, 3) and np.ptp(frame.image) > 50
                assert 0 < frame.arrival - frame.exposure < 1_000_000_000
                account = camera.counts()
                assert account.uncertainty_ms < 10.0 and not account.trouble
                arm.enable()
                assert arm.measure().enabled
            it.send_signal(signal.SIGINT)
            assert it.communicate(timeout=30.0) == ("", "")
        finally:
            it.kill()
        assert it.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--namespace", "PSM 1"], "--namespace must be letters, digits and _"),
        (["--domain", "300"], "--domain must be a whole number from 0 to 232, got 300"),
        (["--interface", "nowhere0", "--domain", "97"], "cannot use nowhere0"),
        (
            ["--mjpeg", "0"],
            "--mjpeg must be left out, because emulate crtk has no such option, got 0",
        ),
        (["--gige"], "--gige must be left out, because emulate crtk has no such option, got True"),
        (["--serial"], "--serial must be left out"),
        (["--port", "2324"], "--port must be left out"),
        (["--fault", "slow:at=1"], "--fault must be left out"),
        (["--seed", "-1"], "--seed must be a whole number that is not negative, got -1"),
    ],
)
def test_invalid_options_are_reported_in_one_sentence(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["emulate", "crtk", *arguments]) == 2
    output = capsys.readouterr()
    assert message in output.err and output.err.count("\n") == 1 and not output.out
