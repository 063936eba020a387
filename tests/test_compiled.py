"""Compiled code is kept where it can be, keyed by what it is made of; without a place it runs."""

import ast
import copy
import inspect
import os
import pickle
import shutil
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import ROOT
from rcmservo.numerics import jit
from rcmservo.numerics.small_linalg import length

PROGRAM = (
    "import numpy as np; from rcmservo.numerics import jit; "
    "from rcmservo.geometry.features import features; "
    "print(jit.cache_folder()); print(features(np.array([1.0, 2.0, 3.0, 5.0]))[1])"
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
    other = source / "rcmservo/cli/cli.py"
    other.write_text(other.read_text() + "\n# a remark\n")
    assert run(source)[0] == before
    kernel = source / "rcmservo/geometry/features.py"
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
    hashed = {path.resolve() for path in jit.sources()}
    assert len(hashed) > 10
    for path in hashed:
        tree = ast.parse(path.read_text())
        for name, origin in imported(tree).items():
            used = any(name in names_in(node) for node in ast.walk(tree) if is_compiled(node))
            assert not used or origin in hashed or origin.name in WITHOUT_NUMBERS, (path, name)


WITHOUT_NUMBERS = {"base.py", "interfaces.py", "numerics/structs.py", "thresholds.py", "state.py"}
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


def printed(program: str, **variables: str) -> list[str]:
    """The words that a program in a process of its own prints."""
    command = [sys.executable, "-c", program]
    environment = os.environ | variables
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()


@pytest.mark.slow
def test_a_kernel_brings_numba_in_on_its_first_call_and_is_in_the_cache_for_the_next_process(
    tmp_path: Path,
) -> None:
    """It calls others of its kind, in another file."""
    program = """
import sys
import numpy as np
from rcmservo.numerics.small_linalg import products
print("numba" in sys.modules)
assert products(np.eye(2), np.eye(2))[1, 1] == 1.0
print(sum(products.stats.cache_hits.values()), len(products.signatures))
"""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    assert printed(program, **cache) == ["False", "0", "1"]
    assert printed(program, **cache) == ["False", "1", "1"]
    assert printed(program, NUMBA_DISABLE_JIT="0", **cache) == ["False", "1", "1"]


def test_as_plain_python_a_kernel_is_the_function_itself() -> None:
    program = "import sys; from rcmservo.numerics.small_linalg import length; "
    program += "print(type(length).__name__, length(__import__('numpy').array([3.0, 4.0])), "
    program += "'numba' in sys.modules)"
    assert printed(program, NUMBA_DISABLE_JIT="1") == ["function", "5.0", "False"]


def test_a_kernel_is_pickled_and_copied_as_a_function_is_by_name() -> None:
    for _ in range(2):  # before and after its first call
        assert pickle.loads(pickle.dumps(length)) is copy.deepcopy(length) is length
        assert length(np.array([3.0, 4.0])) == 5.0
    assert inspect.signature(length) == inspect.signature(length.py_func)  # type: ignore[attr-defined]
    assert not hasattr(length, "_a_name_of_nothing")


@jit.compiled
def doubled(number: float) -> float:
    return 2.0 * number


@jit.compiled
def doubled_and_one(number: float) -> float:
    return doubled(number) + 1.0


def test_a_kernel_called_by_kernels_only_has_no_code_for_calls_from_python() -> None:
    kernel: Any = doubled
    assert doubled_and_one(3.0) == 7.0 and len(kernel.inner.signatures) == 1
    assert not kernel.signatures
    assert doubled(3.0) == 6.0 and len(kernel.signatures) == 1


def test_threads_that_call_a_new_kernel_at_once_share_one_dispatcher() -> None:
    kernel = jit.Kernel(length.py_func)  # type: ignore[attr-defined]
    with ThreadPoolExecutor(8) as pool:
        made = set(pool.map(lambda _: id(kernel.dispatcher), range(64)))
    assert len(made) == 1 and kernel(np.array([3.0, 4.0])) == 5.0
