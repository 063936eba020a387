"""Error messages for invalid command lines: option, value, expected value, and the help."""

import math
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from rcmservo.cli.argument_parsing.option_introspection import list_options
from rcmservo.cli.argument_parsing.parse import parse_options
from rcmservo.cli.cli import main
from rcmservo.cli.run_options import RunOptions
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import BadInput
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.geometry.kinematics import JointLimits
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds
from rcmservo.sim.arm import Drive
from rcmservo.sim.scene import SceneSettings

RUN = "; see rcmservo run --help"
SETTING = "; see rcmservo run --help-all"
SENTENCES = {
    "run --seed": "--seed must be a whole number, got ''" + RUN,
    "run --seed abc": "--seed must be a whole number, got 'abc'" + RUN,
    "run --seed 1.5": "--seed must be a whole number, got '1.5'" + RUN,
    "run --duration x": "--duration must be a number, got 'x'" + RUN,
    "run --projection.observations 2.5": "--projection.observations must be a whole number, "
    "got '2.5'" + SETTING,
    "run --controller.bounds 1 2": "--controller.bounds must be given FLOAT FLOAT FLOAT, "
    "got '1 2'" + SETTING,
    "run --controller.bounds 1 2 x": "--controller.bounds must be given FLOAT FLOAT FLOAT, "
    "got '1 2 x'" + SETTING,
    "run --controller.potential print": "--controller.potential must be one of continuous, "
    "printed, got 'print' (did you mean printed?)" + SETTING,
    "run --controllr.gain 3": "run has no option --controllr.gain (did you mean "
    "--controller.gain?)" + SETTING,
    "run --imaged_rcm.max-conditio 3": "run has no option --imaged_rcm.max-conditio (did you mean "
    "--imaged-rcm.max-condition?)" + SETTING,
    "study --workers x": "--workers must be a whole number, got 'x'; see rcmservo study --help",
    "study --count 0": "--count must be a whole number from 1 to 1e8, got 0; see rcmservo study "
    "--help",
    "run x": "'x' is one argument too many for run" + RUN,
    "show a --seed 3": "show has no option --seed; see rcmservo show --help",
    "show": "PATH must be given: Folder of a run, or an .mcap file; see rcmservo show --help",
    "rnu": "the command must be one of run, live, serve, replay, show, export, paper, study, "
    "tune, emulate, rig, markers, got 'rnu' (did you mean run?); see rcmservo --help",
    "": "a command must be given, one of run, live, serve, replay, show, export, paper, study, "
    "tune, emulate, rig, markers; see rcmservo --help",
}


@pytest.mark.parametrize("line", SENTENCES)
def test_an_invalid_command_line_gives_one_sentence(
    line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    assert capsys.readouterr().err == f"rcmservo: {SENTENCES[line]}\n"


@pytest.mark.parametrize(
    "option",
    [
        "projection.observations",
        "imaged-rcm.lines",
        "imaged-rcm.max-deviation",
        "exploration.min-corners",
        "resumes",
        "duration",
    ],
)
def test_an_excessive_size_is_refused_at_once(
    option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", f"--{option}", "1000000000"]) == 2
    assert "1000000000" in capsys.readouterr().err


SUGGESTED = {
    "run --gain 3": "--controller.gain",
    "run --estimator.gamma 3": "--projection.gamma or --flow.gamma",
    "run --gamma 3": "--projection.gamma or --flow.gamma",
    "run --flwo.gamma 3": "--flow.gamma",
    "run --leg 1": "--exploration.leg-time",
    "run --bounds 1 1 1": "--controller.bounds",
    "run --max_speed 9": "--controller.max-speed",
    "run --sede 1": "--seed",
    "replay x --gama 2": "--projection.gamma",
}


@pytest.mark.parametrize("line", SUGGESTED)
def test_the_suggested_option_is_the_intended_one(
    line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    assert f"(did you mean {SUGGESTED[line]}?)" in capsys.readouterr().err


def test_no_word_stands_for_an_absent_option() -> None:
    assert parse_options("run", RunOptions, ["--rig", "None"]).rig == Path("None")


def test_nothing_is_suggested_for_an_option_unlike_all_others(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["study", "--gain", "3"]) == 2
    assert "did you mean" not in capsys.readouterr().err


OPTION_CLASSES = {one.group: one.owner for one in list_options(RunOptions) if one.group}


def refused_setting(kind: type[Any]) -> str:
    """Return a numeric setting of a class that must not be -1."""
    for f in fields(kind):
        if type(f.default) in (int, float):
            with suppress(BadInput):
                kind(**{f.name: -1})
                continue
            return f.name
    raise AssertionError(f"{kind} takes any number")


@pytest.mark.parametrize("group", OPTION_CLASSES)
def test_a_refused_setting_is_named_as_typed(
    group: str, capsys: pytest.CaptureFixture[str]
) -> None:
    option = f"--{group}.{refused_setting(OPTION_CLASSES[group])}".replace("_", "-")
    assert main(["run", option, "-1"]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"rcmservo: {option} must be ")
    assert re.search(rf"got -1(\.0)?{re.escape(SETTING)}\n$", message)


def test_a_setting_that_does_not_fit_the_estimator_is_named_as_typed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--controller.features", "size", "--out", str(tmp_path / "out")]
    assert main(["run", *words]) == 2
    assert capsys.readouterr().err.startswith("rcmservo: --controller.features must be ")


def test_an_error_in_python_names_the_field_as_records_do() -> None:
    with pytest.raises(BadInput, match=r"^estimator\.gamma must be"):
        FlowEstimator(gamma=-1.0)


def test_values_in_degrees_are_refused_as_radians_and_both_units_are_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", "--controller.bounds", "10", "10", "10"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("rcmservo: --controller.bounds must be at most 3.142 rad")
    assert "(did you mean 0.1745 rad, which is 10 deg?)" in message


def scene_settings(**values: object) -> SceneSettings:
    return SceneSettings(**values)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("make", "meant"),
    [
        (lambda: SaturatedController(bounds=(10.0, 10.0, 10.0)), "0.1745 rad, which is 10 deg?"),
        (lambda: Gate(speed=(30.0, 30.0, 50.0)), "0.5236 rad/s, which is 30 deg/s?"),
        (lambda: Thresholds(max_following_error=(0.1, 5.0, 5.0)), "0.08727 rad, which is 5 deg?"),
        (lambda: scene_settings(errors=(20.0, 50.0, 50.0)), "0.3491 rad, which is 20 deg?"),
        (lambda: scene_settings(start=(10.0, 45.0, 90.0)), "0.7854 rad, which is 45 deg?"),
        (lambda: Drive(encoder_offset=(0.0, 90.0, 0.0)), "1.571 rad, which is 90 deg?"),
        (lambda: JointLimits((-90.0, 0.0, 50.0), (90.0, 1.0, 90.0)), "looks like degrees"),
    ],
)
def test_an_angle_that_can_only_be_degrees_is_refused(
    make: Callable[[], object], meant: str
) -> None:
    with pytest.raises(BadInput, match=re.escape(meant)):
        make()


def test_an_angle_bound_of_half_a_turn_is_accepted() -> None:
    assert SaturatedController(bounds=(math.pi, 10.0, 10.0)).bounds[0] == math.pi
