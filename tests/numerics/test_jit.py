"""Caching of compiled code in a writable folder, keyed by its sources; kernels without a folder."""

import ast
import copy
import importlib
import inspect
import os
import pickle
import shutil
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from rcmservo.numerics import jit
from rcmservo.numerics.small_linalg import compute_norm

PROGRAM = (
    "import numpy as np; from rcmservo.numerics import jit; "
    "from rcmservo.geometry.features import compute_features; "
    "print(jit.find_cache_folder()); print(compute_features(np.array([1.0, 2.0, 3.0, 5.0]))[1])"
)


def copy_source(folder: Path) -> Path:
    shutil.copytree(
        ROOT / "src", folder, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info")
    )
    return folder


def run_with_source(source: Path, program: str = PROGRAM, **variables: str) -> list[str]:
    environment = {**os.environ, "PYTHONPATH": str(source), **variables}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-B", "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.slow
def test_a_change_of_any_file_with_compiled_functions_makes_a_new_cache(tmp_path: Path) -> None:
    source = copy_source(tmp_path / "src")
    folder_only = "from rcmservo.numerics import jit; print(jit.find_cache_folder())"
    before = run_with_source(source, folder_only)
    other = source / "rcmservo/cli/cli.py"
    other.write_text(other.read_text() + "\n# a remark\n")
    assert run_with_source(source, folder_only) == before
    kernel = source / "rcmservo/geometry/features.py"
    kernel.write_text(kernel.read_text() + "\n# a remark\n")
    assert run_with_source(source, folder_only) != before


@pytest.mark.skipif(os.name != "posix", reason="permissions as on POSIX")
def test_kernels_run_where_neither_package_nor_home_is_writable(tmp_path: Path) -> None:
    """A file occupies the path of each folder, which also stops the root user."""
    source = copy_source(tmp_path / "src")
    (source / "rcmservo/__pycache__").write_text("in the way")
    home = tmp_path / "home"
    home.write_text("in the way")
    folder, root = run_with_source(
        source, HOME=str(home), XDG_CACHE_HOME=str(home), TMPDIR=str(tmp_path)
    )
    assert Path(folder).is_relative_to(tmp_path)
    assert stat.S_IMODE(Path(folder).stat().st_mode) & 0o077 == 0
    assert float(root) == pytest.approx(5.0**0.5)


def test_compiled_functions_use_only_hashed_files_of_this_package() -> None:
    """Otherwise an edit in that file would not renew the cache."""
    hashed = {path.resolve() for path in jit.find_kernel_files()}
    assert len(hashed) > 10
    for path in hashed:
        tree = ast.parse(path.read_text())
        for name, origin in list_imported_names(tree).items():
            used = any(name in names_in(node) for node in ast.walk(tree) if is_compiled(node))
            assert not used or origin in hashed or origin.name in TYPE_FILES, (path, name)


TYPE_FILES = {"base.py", "interfaces.py", "numerics/structs.py", "thresholds.py", "state.py"}
"""Files that only define types for compiled functions."""


def is_compiled(node: ast.AST) -> bool:
    marks = node.decorator_list if isinstance(node, ast.FunctionDef) else []
    return any(isinstance(mark, ast.Name) and mark.id == "compiled" for mark in marks)


def names_in(node: ast.AST) -> set[str]:
    assert isinstance(node, ast.FunctionDef)
    body = [part for statement in node.body for part in ast.walk(statement)]
    return {part.id for part in body if isinstance(part, ast.Name)}


def list_imported_names(tree: ast.AST) -> dict[str, Path]:
    """Return the names imported from this package, with the file that defines them."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rcmservo."):
            origin = ROOT / "src" / (str(node.module).replace(".", "/") + ".py")
            found |= {alias.asname or alias.name: origin.resolve() for alias in node.names}
    return found


def run_program(program: str, **variables: str) -> list[str]:
    """Return the words that a program prints in a process of its own."""
    command = [sys.executable, "-c", program]
    environment = os.environ | variables
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()


@pytest.mark.slow
def test_the_first_call_of_a_kernel_imports_numba_and_caches_it_for_other_processes(
    tmp_path: Path,
) -> None:
    """The kernel calls kernels in another file."""
    program = """
import sys
import numpy as np
from rcmservo.numerics.small_linalg import multiply_matrices
print("numba" in sys.modules)
assert multiply_matrices(np.eye(2), np.eye(2))[1, 1] == 1.0
print(sum(multiply_matrices.stats.cache_hits.values()), len(multiply_matrices.signatures))
"""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    assert run_program(program, **cache) == ["False", "0", "1"]
    assert run_program(program, **cache) == ["False", "1", "1"]
    assert run_program(program, NUMBA_DISABLE_JIT="0", **cache) == ["False", "1", "1"]


def test_without_jit_a_kernel_is_the_plain_function() -> None:
    program = "import sys; from rcmservo.numerics.small_linalg import compute_norm; "
    program += (
        "print(type(compute_norm).__name__, compute_norm(__import__('numpy').array([3.0, 4.0])), "
    )
    program += "'numba' in sys.modules)"
    assert run_program(program, NUMBA_DISABLE_JIT="1") == ["function", "5.0", "False"]


def test_a_kernel_is_pickled_and_copied_by_name_like_a_function() -> None:
    for _ in range(2):  # before and after its first call
        assert (
            pickle.loads(pickle.dumps(compute_norm)) is copy.deepcopy(compute_norm) is compute_norm
        )
        assert compute_norm(np.array([3.0, 4.0])) == 5.0
    assert inspect.signature(compute_norm) == inspect.signature(compute_norm.py_func)  # type: ignore[attr-defined]
    assert not hasattr(compute_norm, "_a_name_of_nothing")


TWO_KERNELS = """
from rcmservo.numerics import jit

@jit.compiled
def doubled(number):
    return 2.0 * number

@jit.compiled
def doubled_and_one(number):
    return doubled(number) + 1.0
"""


def test_a_kernel_that_only_kernels_call_has_no_code_for_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernels are in a new file, for which no compiled code is stored."""
    (tmp_path / "two_kernels.py").write_text(TWO_KERNELS)
    monkeypatch.syspath_prepend(str(tmp_path))
    module = importlib.import_module("two_kernels")
    kernel = module.doubled
    assert module.doubled_and_one(3.0) == 7.0 and len(kernel.inner.signatures) == 1
    assert not kernel.signatures
    assert kernel(3.0) == 6.0 and len(kernel.signatures) == 1


def test_concurrent_first_calls_of_a_kernel_share_one_dispatcher() -> None:
    kernel = jit.Kernel(compute_norm.py_func)  # type: ignore[attr-defined]
    with ThreadPoolExecutor(8) as pool:
        made = set(pool.map(lambda _: id(kernel.dispatcher), range(64)))
    assert len(made) == 1 and kernel(np.array([3.0, 4.0])) == 5.0
