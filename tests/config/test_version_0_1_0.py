"""Target and record of version 0.1.0 can be read, and its rig file after the messages' advice.

A replay that this version cannot do names the version that can.
"""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import rcmservo as rs
from conftest import ROOT
from rcmservo.cli.cli import main
from rcmservo.config import target_file
from rcmservo.config.rig_file import RigDescription, load_rig_file
from rcmservo.config.servo_json import describe_servo
from rcmservo.config.target_file import TargetSetup
from rcmservo.errors import BadInput
from rcmservo.recording import reader
from rcmservo.recording.writer import Recorder
from rcmservo.sim.rig_file import read_rig_settings
from rcmservo.tracking import MarkerAppearance

OLD = ROOT / "tests/data/v0.1.0"
NEW_NAME = re.compile(r"its name is (\w+) now")


def renamed_rig(folder: Path) -> RigDescription:
    """Return the rig of version 0.1.0 after its names were changed as the messages advise."""
    text, file = (OLD / "rig.toml").read_text(), folder / "rig.toml"
    for _ in range(20):
        file.write_text(text)
        try:
            return load_rig_file(file)
        except BadInput as error:
            where, present = error.field.split(": ")[-1], NEW_NAME.search(error.expected)
            assert present, error
            section, _, key = where.removeprefix("section ").partition(".")
            old = rf"(^\[{section}\]$.*?^){key}\b" if key else rf"(^\[){section}\b"
            text = re.sub(f"(?ms){old}", rf"\g<1>{present[1]}", text)
    raise AssertionError(text)


def test_its_rig_file_gives_the_same_rig_with_the_names_that_the_messages_give(
    tmp_path: Path,
) -> None:
    lab = renamed_rig(tmp_path)
    limits = rs.JointLimits((-1.5, -0.9, 45.0), (1.5, 0.9, 235.0))
    assert lab.mechanism == rs.PitchYawRcm(limits, 5.0)
    assert lab.tool == rs.RigidTool(spacing=28.0, offset=-2.0)
    assert lab.markers == MarkerAppearance("yellow", "cyan", 3.0, 4.0)
    assert (lab.gate.speed, lab.gate.latency) == ((0.8, 0.8, 70.0), 0.04)
    assert (lab.thresholds.max_jump_px, lab.thresholds.max_following_error) == (
        3.5,
        (0.008, 0.008, 0.6),
    )
    settings = read_rig_settings(lab)
    assert (settings.timing.frame_rate, settings.point_noise) == (50.0, 0.2)
    assert settings.drive.lag == 0.025 and settings.scene.insertion == (60.0, 150.0)


def test_its_target_loads_for_the_same_setup(tmp_path: Path) -> None:
    lab = renamed_rig(tmp_path)
    name = "simulation with seed 3, view ae914c9f"
    setup = TargetSetup(name, 640, 480, lab.mechanism, lab.tool, lab.markers)
    target = target_file.load_target(OLD / "target.json", setup)
    assert target.points[0].tolist() == [386.80959824902493, 212.98916869997595]
    assert target.q.tolist() == [0.48719999999999974, -0.19787999999999992, 110.50599999999996]


@pytest.mark.usefixtures("blank_figures")
def test_its_record_can_be_shown_and_exported(tmp_path: Path) -> None:
    shutil.copy(OLD / "record.mcap", tmp_path / "record.mcap")
    assert main(["show", str(tmp_path / "record.mcap"), "--out", str(tmp_path / "shown")]) == 0
    assert main(["export", str(tmp_path / "record.mcap"), "--out", str(tmp_path / "out")]) == 0
    with np.load(tmp_path / "out/record.npz") as arrays:
        assert arrays["J_hat"].shape == (300, 9) and arrays["stage_first"].tolist() == [0]
    assert len((tmp_path / "out/ticks.csv").read_text().splitlines()) == 301


def test_its_record_has_no_marker_sizes() -> None:
    rows = reader.read_record(OLD / "record.mcap")
    assert rows.ticks["sizes"].shape == (300, 2) and np.isnan(rows.ticks["sizes"]).all()
    assert np.isfinite(rows.ticks["points"]).any() and rows.complete


def test_its_record_names_the_version_that_wrote_it() -> None:
    assert reader.read_record(OLD / "record.mcap").version == "0.1.0"


def test_a_record_with_unknown_settings_names_the_version_that_wrote_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def before(servo: rs.Servo) -> dict[str, object]:
        table = describe_servo(servo)
        del table["thresholds"]["max_jump_px"]
        return table

    monkeypatch.setattr("rcmservo.recording.stage.describe_servo", before)
    monkeypatch.setattr("rcmservo.recording.stage.find_version", lambda _: "0.1.7")
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        recorder.begin(servo, rs.Target(np.zeros((2, 2)), np.zeros(3)))
    assert main(["replay", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "servo.thresholds.max_jump_px must be given" in error
    assert "replay it with rcmservo 0.1.7, which has written it" in error
    assert len(error.splitlines()) == 1


def test_a_replay_of_its_record_agrees_or_names_the_version(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = main(["replay", str(OLD / "record.mcap")])
    output = capsys.readouterr()
    assert (code == 0 and "the same, bit for bit" in output.out) or (
        code == 2 and "replay it with rcmservo 0.1.0" in output.err
    )


def test_a_new_stage_names_the_present_version(tmp_path: Path) -> None:
    with Recorder(tmp_path / "record.mcap", {}) as recorder:
        servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(spacing=30.0))
        recorder.begin(servo, rs.Target(np.zeros((2, 2)), np.zeros(3)))
    stage = reader.read_record(tmp_path / "record.mcap").stages[0]
    assert (stage.version, stage.source) == (rs.__version__, "")
    assert json.dumps(stage.servo) == json.dumps(describe_servo(servo))
