"""Compiled code is kept where it can be, keyed by what it is made of; without a place it runs."""

import ast
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ROOT
from rcmservo import compiled

PROGRAM = (
    "import numpy as np; from rcmservo import compiled; "
    "from rcmservo.method.features import features; "
    "print(compiled._CACHE); print(features(np.array([1.0, 2.0, 3.0, 5.0]))[1])"
)


def copied(folder: Path) -> Path:
    shutil.copytree(
        ROOT / "src", folder, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
    )
    return folder


def run(source: Path, **variables: str) -> list[str]:
    environment = {**os.environ, "PYTHONPATH": str(source), **variables}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-B", "-c", PROGRAM]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.slow
def test_a_change_of_any_file_with_compiled_functions_makes_a_new_cache(tmp_path: Path) -> None:
    source = copied(tmp_path / "src")
    before = run(source)[0]
    other = source / "rcmservo/app/cli.py"
    other.write_text(other.read_text() + "\n# a remark\n")
    assert run(source)[0] == before
    kernel = source / "rcmservo/method/features.py"
    kernel.write_text(kernel.read_text() + "\n# a remark\n")
    assert run(source)[0] != before


@pytest.mark.skipif(os.name != "posix", reason="permissions as on POSIX")
def test_where_neither_package_nor_home_can_be_written_to_it_still_runs(tmp_path: Path) -> None:
    """A file stands where each folder would be, which stops root too."""
    source = copied(tmp_path / "src")
    (source / "rcmservo/__pycache__").write_text("in the way")
    home = tmp_path / "home"
    home.write_text("in the way")
    place, root = run(source, HOME=str(home), XDG_CACHE_HOME=str(home), TMPDIR=str(tmp_path))
    assert Path(place).is_relative_to(tmp_path)
    assert stat.S_IMODE(Path(place).stat().st_mode) & 0o077 == 0
    assert float(root) == pytest.approx(5.0**0.5)


def test_what_a_compiled_function_names_of_this_package_stands_in_a_file_that_is_hashed() -> None:
    """Otherwise an edit there would go unseen."""
    hashed = {path.resolve() for path in compiled.sources()}
    assert len(hashed) > 10
    for path in hashed:
        tree = ast.parse(path.read_text())
        for name, origin in imported(tree).items():
            used = any(name in names_in(node) for node in ast.walk(tree) if is_compiled(node))
            assert not used or origin in hashed or origin.name in WITHOUT_NUMBERS, (path, name)


WITHOUT_NUMBERS = {"interfaces.py", "rows.py", "thresholds.py", "state.py"}
"""Files of types alone as far as compiled functions see them."""


def is_compiled(node: ast.AST) -> bool:
    marks = node.decorator_list if isinstance(node, ast.FunctionDef) else []
    return any(isinstance(mark, ast.Name) and mark.id == "compiled" for mark in marks)


def names_in(node: ast.AST) -> set[str]:
    assert isinstance(node, ast.FunctionDef)
    body = [part for statement in node.body for part in ast.walk(statement)]
    return {part.id for part in body if isinstance(part, ast.Name)}


def imported(tree: ast.AST) -> dict[str, Path]:
    """Names imported from this package, by the file they come from."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rcmservo."):
            origin = ROOT / "src" / (str(node.module).replace(".", "/") + ".py")
            found |= {alias.asname or alias.name: origin.resolve() for alias in node.names}
    return found
