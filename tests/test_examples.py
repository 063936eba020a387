"""Examples: they run as they are, with the output that they describe.

The longer ones run in this process, because a new one takes seconds to import what they need.
"""

import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import ROOT


@pytest.fixture
def run_example(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Function that runs an example in an empty folder and returns what it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def run(name: str, *words: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *words])
        runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_gains_are_compared_in_the_same_scenes(run_example: Callable[..., str]) -> None:
    printed = run_example("03_many_runs.py", "6")
    rows = re.findall(r"^│ gain (\d+) +│ random │ +(\d+\.\d) │ +(\d\.\d\d) │", printed, re.M)
    assert [row[0] for row in rows] == ["2", "6", "12"]
    assert all(float(row[1]) > 50.0 for row in rows)
    slow, _, fast = (float(row[2]) for row in rows)
    assert fast < slow and "gain 12 compared with gain 2, random, 6 pairs" in printed


@pytest.mark.slow
def test_a_user_defined_estimator_is_compared_with_the_default(
    run_example: Callable[..., str],
) -> None:
    printed = run_example("02_own_estimator.py", "2")
    rows = re.findall(r"^│ (\w+) +│ random │ +(\d+\.\d) │", printed, re.M)
    assert rows == [("default", "100.0"), ("pixels", "100.0")]
    assert "pixels compared with default, random, 2 pairs" in printed


@pytest.mark.slow
def test_the_program_of_the_readme_prints_what_the_readme_quotes(tmp_path: Path) -> None:
    code = [sys.executable, ROOT / "examples/00_readme.py"]
    done = subprocess.run(code, cwd=tmp_path, capture_output=True, text=True, check=True)
    quoted = re.search(r"which prints `([^`]+)`", (ROOT / "README.md").read_text())
    assert quoted is not None and done.stdout == f"{quoted[1]}\n"
    assert (tmp_path / "runs/first/record.mcap").exists()
