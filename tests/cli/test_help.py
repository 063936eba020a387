"""Help of the commands: basics on one page, all options with --help-all, and few imports."""

import os
import subprocess
import sys

import pytest

from rcmservo.cli.argument_parsing.help_text import describe_estimators
from rcmservo.cli.argument_parsing.option_introspection import list_options
from rcmservo.cli.cli import COMMANDS, load_options_class, main
from rcmservo.cli.servo_options import ESTIMATOR_NAMES

PAGE_LINES = 45
"""Largest number of lines of the basic help."""
WITH_SETTINGS = "run", "live", "serve", "replay"

UNUSED_BY_HELP = (
    "numba",
    "llvmlite",
    "cv2",
    "mujoco",
    "nicegui",
    "dask",
    "distributed",
    "scipy",
    "matplotlib",
    "optuna",
    "pyarrow",
    "pydantic",
    "av",
    "cyclonedds",
    "rosbags",
)
USED_BY_COMMANDS = "numpy", "tyro", "rich"


def help_of(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(list(words)) == 0
    return capsys.readouterr().out


def loaded(program: str, *modules: str) -> list[str]:
    """Return the modules that a new process has loaded after a program."""
    code = f"import sys\n{program}\nprint([x for x in {modules!r} if x in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return eval(done.stdout.splitlines()[-1])


def asking(*words: str) -> str:
    return f"from rcmservo.__main__ import main\nsys.argv[1:] = {list(words)!r}\nassert not main()"


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_version_and_list_of_commands_load_no_library(option: str) -> None:
    assert loaded(asking(option), *USED_BY_COMMANDS, *UNUSED_BY_HELP) == []


def test_the_help_of_a_command_loads_nothing_that_computes() -> None:
    """One process asks for the help of all commands, one after the other."""
    check = f"assert not [x for x in {UNUSED_BY_HELP!r} if x in sys.modules]"
    helps = [f"{asking(command, '--help')}\n{check}, {command!r}" for command in COMMANDS]
    assert loaded("\n".join(helps), *UNUSED_BY_HELP) == []


@pytest.mark.parametrize(
    "registry", ["rcmservo.config.class_registry", "rcmservo.hardware.device_kinds"]
)
def test_a_registry_loads_nothing_that_computes(registry: str) -> None:
    assert loaded(f"import {registry}", *UNUSED_BY_HELP, "tyro", "rich") == []


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("columns", [80, 60])
def test_no_line_of_a_help_is_wider_than_the_terminal(
    command: str,
    columns: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    for option in ("--help", "--help-all"):
        lines = help_of(capsys, command, option).splitlines()
        assert max(map(len, lines)) <= columns
        assert lines[0].startswith(f"usage: rcmservo {command}")


@pytest.mark.parametrize("command", WITH_SETTINGS)
def test_the_basics_are_one_page_and_explain_every_estimator(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = help_of(capsys, command, "--help")
    assert len(text.splitlines()) <= PAGE_LINES
    rows = text.partition("estimators:\n")[2].splitlines()
    assert set(ESTIMATOR_NAMES) <= {row.split()[0] for row in rows if row.startswith("  ")}
    assert "--controller." not in text and f"rcmservo {command} --help-all" in text


def test_every_estimator_has_one_sentence_that_fits_the_page() -> None:
    words = describe_estimators()
    assert list(words) == list(ESTIMATOR_NAMES)
    assert all(words.values())


@pytest.mark.parametrize("command", COMMANDS)
def test_help_all_shows_every_option_with_its_default(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = " ".join(help_of(capsys, command, "--help-all").split())
    for one in list_options(load_options_class(command, [])):
        usage = one.name.replace(".", ".[no-]").replace("--", "--[no-]", "." not in one.name)
        assert (usage if one.is_flag else f"{one.name} {one.metavar}") in text or one.is_positional
        assert one.description and " ".join(one.description.split()) in text
        assert f"(default: {one.default})" in text or not one.default
    assert ("(default: dlt)" in text) == (command in ("run", "live", "serve"))


@pytest.mark.parametrize(
    ("words", "usage"),
    [
        (["rig", "check", "--help"], "usage: rcmservo rig check PATH [options]"),
        (["emulate", "galil", "--help"], "usage: rcmservo emulate {galil,crtk} [options]"),
        (["emulate", "crtk", "-h"], "usage: rcmservo emulate {galil,crtk} [options]"),
        (["tune", "--help"], "usage: rcmservo tune FILE [options]"),
        (["study", "--help"], "usage: rcmservo study [FILE] [options]"),
        (["show", "--help"], "usage: rcmservo show PATH [options]"),
        (["run", "--help"], "usage: rcmservo run [options]"),
    ],
)
def test_the_usage_line_names_the_arguments(
    words: list[str], usage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert help_of(capsys, *words).splitlines()[0] == usage


def test_the_list_of_commands_names_each_on_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    lines = help_of(capsys, "--help").splitlines()
    assert max(map(len, lines)) <= 80
    assert [line.split()[0] for line in lines if line.startswith("  ")] == list(COMMANDS)


@pytest.mark.parametrize("words", ["--help", "run --help-all", "run --disturb help"])
def test_a_reader_that_has_read_enough_causes_no_error(words: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "rcmservo", *words.split()]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")
