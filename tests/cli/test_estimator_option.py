"""`--estimator module:class`: run, replay, settings as options, and error messages."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ROOT, SMALL_RIG_TOML
from rcmservo.cli.cli import main, parse_command_options
from rcmservo.recording.reader import read_record

NAME = "lab_of_mine.rls:RLS"
SHORT = ["--rig", "small.toml", "--duration", "1.2", "--no-video", "--json"]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a folder with a package that holds the example's estimator."""
    package = tmp_path / "lab_of_mine"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "rls.py").write_text((ROOT / "examples/02_own_estimator.py").read_text())
    (tmp_path / "small.toml").write_text(SMALL_RIG_TOML)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("lab_of_mine", "lab_of_mine.rls"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


def printed_json(capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_a_user_estimator_runs_with_its_settings_and_replays_bit_for_bit(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--estimator", NAME, "--pixels.forgetting", "0.95", "--out", "run", *SHORT]
    words += ["--teaching-frames", "10"]
    assert main(["run", *words]) in (0, 1)
    assert printed_json(capsys)["estimator"] == NAME
    assert main(["replay", "run", "--json", f"--estimator={NAME}"]) == 0
    second = printed_json(capsys)
    assert second["same"] and not second["open_loop"] and second["changed"] == ""
    assert main(["replay", "run", "--json", "--estimator", NAME, "--pixels.forgetting", "0.8"]) == 1
    assert printed_json(capsys)["open_loop"]
    (here / "lab_of_mine/rls.py").open("a").write("# changed\n")
    assert main(["replay", "run", "--estimator", NAME]) == 0
    assert f"the source of {NAME} has changed since" in capsys.readouterr().out
    assert main(["replay", "run"]) == 2
    assert NAME in capsys.readouterr().err


@pytest.mark.alone
@pytest.mark.slow
def test_a_user_estimator_servos_live_in_another_process_and_replays(here: Path) -> None:
    live = [
        "live",
        "--rig",
        "small.toml",
        "--estimator",
        NAME,
        "--pixels.forgetting",
        "0.95",
        "--duration",
        "1.2",
        "--teaching-frames",
        "10",
    ]
    command = [sys.executable, "-m", "rcmservo", *live, "--out", "run"]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    assert main(["replay", "run", "--estimator", NAME]) == 0
    assert read_record(here / "run").stages[0].servo["estimator"]["forgetting"] == 0.95


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--estimator", NAME, "--pixels.forgettin", "0.9"], "--pixels.forgetting"),
        (
            ["--estimator", NAME, "--pixels.forgetting", "much"],
            "--pixels.forgetting must be a number",
        ),
        (["--estimator", "flwo"], "(did you mean flow?), got 'flwo'"),
        (["--estimator", "lab_of_mine.rls:rls"], "derives from rcmservo.Estimator"),
    ],
)
def test_an_invalid_user_estimator_gives_one_sentence(
    words: list[str], sentence: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *words, "--out", "run"]) == 2
    message = capsys.readouterr().err
    assert sentence in message and len(message.splitlines()) == 1 and not (here / "run").exists()


def test_a_user_estimator_that_fails_its_trial_is_refused_before_anything_is_written(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = here / "lab_of_mine/rls.py"
    code.write_text(code.read_text().replace("memory[0][:, :3]", "memory[0]"))
    for command in ("run", "live"):
        assert main([command, "--estimator", NAME, "--out", "run"]) == 2
        message = capsys.readouterr().err
        assert (
            f"estimator {NAME}: its jacobian returned an array of shape (3, 4), expected (3, 3)"
            in (message)
        )
        assert not (here / "run").exists()


@pytest.mark.parametrize(
    ("command", "name", "group"),
    [
        ("run", "pixels", "pixels"),
        ("run", "seed", "own"),
        ("run", "lab", "own"),
        ("replay path", "path", "own"),
    ],
)
def test_option_groups_of_user_estimators_avoid_names_of_the_command(
    command: str, name: str, group: str, here: Path
) -> None:
    code = here / "lab_of_mine/rls.py"
    code.write_text(code.read_text().replace('name = "pixels"', f'name = "{name}"'))
    words = [*command.split(), "--estimator", NAME, f"--{group}.forgetting", "0.5"]
    options = parse_command_options(words[0], words[1:])
    assert options.user_estimators == {NAME: getattr(options, group)}
    assert getattr(options, group).forgetting == 0.5
