"""Settings of earlier versions: records are read, commands and rig files name the present ones."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

import rcmservo as rs
from rcmservo.cli.cli import main
from rcmservo.config.class_registry import KIND_KEY, PART_CLASSES
from rcmservo.config.former_names import FORMER_SETTINGS, replace_former_names
from rcmservo.config.servo_json import describe_servo, rebuild_servo

SERVO = rs.Servo(
    mechanism=rs.SphericalRcm(),
    tool=rs.RigidTool(spacing=30.0),
    estimator=rs.KalmanEstimator(initial_std=0.5),
    exploration=rs.Exploration(speed_scale=0.3),
    thresholds=rs.Thresholds(max_jump_px=41.0),
)


def as_of_earlier_versions(table: Any) -> Any:
    """Return settings with their former names."""
    former = {present: name for name, present in FORMER_SETTINGS.items()}
    if not isinstance(table, dict):
        return table
    return {former.get(key, key): as_of_earlier_versions(value) for key, value in table.items()}


def test_a_recorded_servo_with_former_names_is_rebuilt() -> None:
    old = as_of_earlier_versions(describe_servo(SERVO))
    assert "share" in old["exploration"] and "jump" in old["thresholds"]
    assert rebuild_servo(old) == SERVO


def test_a_former_name_is_no_present_name_of_the_same_class() -> None:
    kinds = {kind for kinds in PART_CLASSES.values() for kind in kinds.values()}
    for kind in kinds:
        names = {f.name for f in fields(kind)}
        renamed = names & set(FORMER_SETTINGS.values())
        assert not {old for old, new in FORMER_SETTINGS.items() if new in renamed} & names


def test_present_names_stay() -> None:
    assert replace_former_names({"max_jump_px": 1.0, KIND_KEY: "x"}, ["max_jump_px", KIND_KEY]) == {
        "max_jump_px": 1.0,
        KIND_KEY: "x",
    }


@pytest.mark.parametrize(
    ("option", "present"),
    [
        ("--exploration.share", "--exploration.speed-scale"),
        ("--kalman.spread", "--kalman.initial-std"),
    ],
)
def test_a_former_option_is_refused_with_the_present_one(
    option: str, present: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", option, "1"]) == 2
    assert f"(did you mean {present}?)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "present"),
    [
        ("[thresholds]\njump = 40.0\n", "max_jump_px"),
        ("[look]\nnoise = 1.0\n", "appearance"),
    ],
)
def test_a_former_key_of_a_rig_file_is_refused_with_the_present_one(
    text: str, present: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(text)
    assert main(["run", "--rig", str(rig)]) == 2
    assert f"(its name is {present} now)" in capsys.readouterr().err
