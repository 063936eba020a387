"""Examples: they run as they are, with the output that they describe."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ROOT


@pytest.mark.slow
def test_gains_are_compared_in_the_same_scenes() -> None:
    code = [sys.executable, "examples/03_many_runs.py", "6"]
    done = subprocess.run(code, cwd=ROOT, capture_output=True, text=True, check=True)
    rows = re.findall(r"^│ gain (\d+) +│ random │ +(\d+\.\d) │ +(\d\.\d\d) │", done.stdout, re.M)
    assert [row[0] for row in rows] == ["2", "6", "12"]
    assert all(float(row[1]) > 50.0 for row in rows)
    slow, _, fast = (float(row[2]) for row in rows)
    assert fast < slow and "gain 12 compared with gain 2, random, 6 pairs" in done.stdout


@pytest.mark.slow
def test_a_user_defined_estimator_is_compared_with_the_default() -> None:
    code = [sys.executable, "examples/02_own_estimator.py", "2"]
    done = subprocess.run(code, cwd=ROOT, capture_output=True, text=True, check=True)
    rows = re.findall(r"^│ (\w+) +│ random │ +(\d+\.\d) │", done.stdout, re.M)
    assert rows == [("default", "100.0"), ("pixels", "100.0")]
    assert "pixels compared with default, random, 2 pairs" in done.stdout


@pytest.mark.slow
def test_the_program_of_the_readme_prints_what_the_readme_quotes(tmp_path: Path) -> None:
    code = [sys.executable, ROOT / "examples/00_readme.py"]
    done = subprocess.run(code, cwd=tmp_path, capture_output=True, text=True, check=True)
    quoted = re.search(r"which prints `([^`]+)`", (ROOT / "README.md").read_text())
    assert quoted is not None and done.stdout == f"{quoted[1]}\n"
    assert (tmp_path / "runs/first/record.mcap").exists()
