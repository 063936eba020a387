"""docs/bring_up.md: its commands are commands, and its rig file is one."""

import re
import shlex
from pathlib import Path

from conftest import ROOT
from rcmservo.app.cli import asked_of
from rcmservo.app.lab.emulate import COUNTS, EmulateOptions
from rcmservo.app.lab.markers import MarkersOptions
from rcmservo.app.lab.rig_check import RigOptions
from rcmservo.app.live import LiveOptions
from rcmservo.config.rig_file import load_lab
from rcmservo.hardware.devices import ARMS, CAMERAS, wiring_of

PAGE = (ROOT / "docs/bring_up.md").read_text()


def test_every_command_of_the_page_can_be_read() -> None:
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
    lines = [line for block in blocks for line in block.splitlines()]
    words = [shlex.split(line)[1:] for line in lines]
    read = [asked_of(name, options) for name, *options in words]
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
