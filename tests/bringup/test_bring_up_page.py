"""docs/bring_up.md: valid commands, a valid rig file, and answers to all questions."""

import re
import shlex
from dataclasses import MISSING, fields
from pathlib import Path

import pytest
from rig_check_lab import FaultyLab, Mistake

from bring_up_page import PAGE, answer_to
from conftest import ROOT
from rcmservo.cli.cli import parse_command_options
from rcmservo.cli.lab.emulate import COUNTS_PER_UNIT, EmulateOptions
from rcmservo.cli.lab.emulated_arm import EmulatedArm
from rcmservo.cli.lab.markers import MarkersOptions
from rcmservo.cli.lab.rig_check import RigOptions
from rcmservo.cli.live import LiveOptions
from rcmservo.config.rig_file import RigDescription, decode_rig_tables, load_rig_file
from rcmservo.errors import BadInput
from rcmservo.hardware.device_kinds import ARM_KINDS, CAMERA_KINDS, read_wiring
from rcmservo.hardware.lab_rig import require_devices

SEED = int(re.search(r"--seed (\d+)", PAGE)[1])  # type: ignore[index]
"""Seed of the page's emulated laboratory."""


def test_every_command_of_the_page_parses() -> None:
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
    lines = [line for block in blocks for line in block.splitlines()]
    words = [shlex.split(line)[1:] for line in lines]
    read = [parse_command_options(name, options) for name, *options in words]
    assert [type(one) for one in read] == [
        EmulateOptions,
        MarkersOptions,
        RigOptions,
        LiveOptions,
    ]


def test_the_rig_file_of_the_page_describes_the_emulated_laboratory(tmp_path: Path) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
    path = tmp_path / "lab.toml"
    path.write_text(block)
    lab = load_rig_file(path)
    assert read_wiring(lab).counts == COUNTS_PER_UNIT
    assert lab.decode_device_settings("arm", ARM_KINDS).port == 2323
    assert "8080" in lab.decode_device_settings("camera", CAMERA_KINDS).source


REQUIRED = re.search(r"\*\*Required\*\*.*?\n\n", PAGE, re.S)[0]  # type: ignore[index]
"""Paragraph of the page on required keys of a rig file."""


def test_the_page_names_every_key_without_a_default() -> None:
    named = set(re.findall(r"`(\w+)`", REQUIRED))
    devices = [*ARM_KINDS.values(), *CAMERA_KINDS.values()]
    needed = {f.name for kind in devices for f in fields(kind) if f.default is MISSING}
    kinds = {kind.name for kind in devices}
    assert named == needed | kinds | {"kind", "latency", "live", "serve"}


MINIMAL = {
    "galil": {"arm": {"kind": "galil", "address": "127.0.0.1", "counts": [1e4, 1e4, 1e2]}},
    "crtk": {"arm": {"kind": "crtk", "namespace": "PSM1"}},
    "opencv": {"camera": {"kind": "opencv", "source": "0", "latency": 0.02}},
    "aravis": {"camera": {"kind": "aravis", "address": "192.168.1.20", "latency": 0.02}},
    "topic": {"camera": {"kind": "topic", "topic": "PSM1/image_raw"}},
}
"""Tables of each kind of device with only the keys that the page requires."""
OTHER_DEVICES = {"arm": "galil", "camera": "opencv"}


@pytest.mark.parametrize("kind", MINIMAL)
def test_the_required_keys_suffice_and_each_missing_one_is_reported(kind: str) -> None:
    ((section, table),) = MINIMAL[kind].items()
    whole = {**MINIMAL[OTHER_DEVICES["arm"]], **MINIMAL[OTHER_DEVICES["camera"]], section: table}
    require_devices(decode_rig_tables(whole), Path("lab.toml"), "")
    for key in table:
        rest = {name: value for name, value in table.items() if name != key}
        with pytest.raises(BadInput, match=rf"{section}\.{key} must be "):
            require_devices(decode_rig_tables({**whole, section: rest}), Path("lab.toml"), "")
    for missing in OTHER_DEVICES:
        rest = {name: one for name, one in whole.items() if name != missing}
        with pytest.raises(BadInput, match=f"section {missing} must be given"):
            require_devices(decode_rig_tables(rest), Path("lab.toml"), "")


def test_the_page_on_live_runs_links_to_this_one_for_the_keys() -> None:
    live = (ROOT / "docs/live_on_hardware.md").read_text()
    assert "[bring_up.md](bring_up.md#2-the-rig-file)" in live
    assert "\n## 2. The rig file\n" in PAGE


@pytest.mark.slow
def test_the_answers_of_the_page_lead_to_the_only_finding() -> None:
    """A wrong spacing triggers a question that a correct rig file does not. Simulated time."""
    with EmulatedArm(SEED, RigDescription()) as arm:
        printed = arm.ruler_measurements
    lab = FaultyLab(Mistake(spacing=1.25), SEED, RigDescription().mechanism)
    lab.operator.override = lambda question: answer_to(question, printed)
    report = lab.check()
    for words in ("in which direction", "how far apart"):
        assert any(words in question for question in lab.operator.questions)
    assert report.done and [one.where for one in report.findings] == ["tool.spacing"]
