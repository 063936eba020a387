"""Optional packages: a missing one is reported with the command that installs it."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from conftest import ROOT

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
STUDY_PACKAGES = "cryptography", "dask", "distributed", "optuna", "pyarrow"
HIDE_PACKAGES = "import sys; sys.modules.update(dict.fromkeys({names!r}))\n"


def run_without(
    names: tuple[str, ...], code: str, folder: Path
) -> "subprocess.CompletedProcess[str]":
    line = [sys.executable, "-c", HIDE_PACKAGES.format(names=names) + code]
    return subprocess.run(line, capture_output=True, text=True, check=False, cwd=folder)


ADVICE = ", which is not installed: run pip install -e '.[{extra}]' in the clone of rcmservo"


def test_python_names_the_command_that_installs_a_missing_package(tmp_path: Path) -> None:
    parts = {"execution.store": "pyarrow", "execution.workers": "distributed"}
    code = "from importlib import import_module\nfrom rcmservo.errors import NotInstalled\n"
    code += f"for part in {tuple(parts)}:\n try: import_module('rcmservo.study.' + part)\n"
    code += " except NotInstalled as error: print(error)"
    done = run_without(STUDY_PACKAGES, code, tmp_path)
    advice = ADVICE.format(extra="study")
    assert done.stdout.splitlines() == [f"a study needs {one}{advice}" for one in parts.values()]


@pytest.mark.parametrize(
    ("package", "commands", "extra"),
    [
        ("mujoco", ("run", "live", "paper", "serve", "emulate galil", "emulate crtk"), "sim"),
        ("nicegui", ("serve",), "page"),
    ],
)
def test_commands_name_the_command_that_installs_a_missing_package(
    package: str, commands: tuple[str, ...], extra: str, tmp_path: Path
) -> None:
    code = "from rcmservo.cli.cli import main\n"
    code += f"sys.exit(set(main(line.split()) for line in {commands}) != {{2}})"
    done = run_without((package,), code, tmp_path)
    assert done.returncode == 0, done.stderr
    advice = f" needs {package}{ADVICE.format(extra=extra)}"
    names = [line.split()[0] for line in commands]
    assert done.stderr.splitlines() == [f"rcmservo: {name}{advice}" for name in names]


def test_the_simulator_in_python_names_the_command_that_installs_it(tmp_path: Path) -> None:
    for name in ("sim.Rig", "study.compare"):
        done = run_without(("mujoco",), f"import rcmservo as rs; rs.{name}", tmp_path)
        message = f"rcmservo.{name.partition('.')[0]} needs mujoco" + ADVICE.format(extra="sim")
        assert message in done.stderr


@pytest.mark.slow
def test_the_paper_runs_without_the_packages_of_studies(tmp_path: Path) -> None:
    code = "from rcmservo.cli.cli import main; sys.exit(main(['paper', '--quick', '--only', "
    code += "'lemma-1', '--out', 'paper']))"
    done = run_without(STUDY_PACKAGES, code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "paper/report.html").exists()


def test_no_page_and_no_message_installs_an_unpublished_package() -> None:
    files = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*"), *(ROOT / "src").rglob("*.py")]
    texts = {path.name: path.read_text() for path in files if path.suffix in {".md", ".py", ".j2"}}
    assert [name for name, text in texts.items() if re.search(r"install +'?rcmservo", text)] == []
    advised = re.findall(r"install -e '\.\[([\w,]+)\]'", "".join(texts.values()))
    assert {name for names in advised for name in names.split(",")} <= set(EXTRAS)
