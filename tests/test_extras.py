"""What `make run` leaves out is reported with the command that installs it, and missed by nothing
else."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from conftest import ROOT

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
OF_STUDIES = "cryptography", "dask", "distributed", "optuna", "pyarrow"
WITHOUT = "import sys; sys.modules.update(dict.fromkeys({names!r})); "


def without(names: tuple[str, ...], code: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    line = [sys.executable, "-c", WITHOUT.format(names=names) + code]
    return subprocess.run(line, capture_output=True, text=True, check=False, cwd=folder)


@pytest.mark.parametrize(
    ("package", "code", "said"),
    [
        ("pyarrow", "import rcmservo.study.work.store", "a study needs pyarrow .*[study]"),
        ("distributed", "import rcmservo.study.work.crew", "a study needs distributed .*[study]"),
        ("optuna", "import rcmservo.study.tuning.search", "a study needs optuna .*[study]"),
        ("mujoco", "import rcmservo as rs; rs.sim", "rcmservo.sim needs mujoco .*[sim]"),
        ("mujoco", "import rcmservo as rs; rs.study", "rcmservo.study needs mujoco .*[sim]"),
    ],
)
def test_python_names_the_command_that_installs_what_is_missing(
    package: str, code: str, said: str, tmp_path: Path
) -> None:
    last = without((package,), code, tmp_path).stderr.splitlines()[-1]
    words, _, extra = said.partition(" .*")
    assert last.startswith(f"rcmservo.errors.NotInstalled: {words}, which is not installed: ")
    assert f"pip install -e '.{extra}'" in last


@pytest.mark.parametrize(
    ("package", "command", "extra"),
    [
        ("mujoco", "run", "sim"),
        ("mujoco", "live", "sim"),
        ("mujoco", "paper", "sim"),
        ("mujoco", "emulate galil", "sim"),
        ("mujoco", "serve", "sim"),
        ("nicegui", "serve", "page"),
        ("optuna", "tune search.toml", "study"),
        ("distributed", "study", "study"),
    ],
)
def test_a_command_names_the_command_that_installs_what_is_missing(
    package: str, command: str, extra: str, tmp_path: Path
) -> None:
    code = f"from rcmservo.app.cli import main; sys.exit(main({command.split()!r}))"
    done = without((package,), code, tmp_path)
    assert done.returncode == 2
    assert re.fullmatch(
        rf"rcmservo: .* needs {package}, which is not installed: run pip install -e "
        rf"'\.\[{extra}\]' in the clone of rcmservo\n",
        done.stderr,
    )


@pytest.mark.slow
def test_the_paper_needs_nothing_of_studies(tmp_path: Path) -> None:
    code = "from rcmservo.app.cli import main; sys.exit(main(['paper', '--quick', '--only', "
    code += "'lemma-1', '--out', 'paper']))"
    done = without(OF_STUDIES, code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "paper/report.html").exists()


def test_no_page_and_no_message_advises_a_name_that_is_on_no_index() -> None:
    files = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*"), *(ROOT / "src").rglob("*.py")]
    texts = {path.name: path.read_text() for path in files if path.suffix in {".md", ".py", ".j2"}}
    assert [name for name, text in texts.items() if re.search(r"install +'?rcmservo", text)] == []
    advised = re.findall(r"install -e '\.\[([\w,]+)\]'", "".join(texts.values()))
    assert {name for names in advised for name in names.split(",")} <= set(EXTRAS)
