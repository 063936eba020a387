"""Archives of user modules hold the module and its local imports, and their hash covers both."""

import importlib
import sys
from collections.abc import Generator
from pathlib import Path

import pytest
from studies import InProcessPool

from rcmservo.config.user_estimators import import_estimator
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.study.execution.run_study import StudyExecution
from rcmservo.study.plan.file import StudyFile, make_plan
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.plan.user_module_archive import ModuleArchive, archive_module, load_classes

MODULE = "archived_module"
HELPER = "FACTOR = {factor}\n"
SOURCE = """
from dataclasses import dataclass
import archived_module_helper
import rcmservo as rs
from rcmservo.estimation.flow_rule import FlowEstimator

@dataclass(frozen=True)
class One(FlowEstimator):
    name = "one"
    def factor(self):
        return archived_module_helper.FACTOR

@dataclass(frozen=True)
class Other(FlowEstimator):
    name = "other"

@dataclass(frozen=True, kw_only=True)
class Lacks(FlowEstimator):
    needed: float
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Path]:
    """Create a folder with a user module and a helper that it imports."""
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    (tmp_path / f"{MODULE}_helper.py").write_text(HELPER.format(factor=1.0))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    forget_imports()


def forget_imports() -> None:
    """Remove all imports of the module from this process."""
    sys.path[:] = [folder for folder in sys.path if "rcmservo-" not in folder]
    for name in [name for name in sys.modules if name.startswith(MODULE)]:
        del sys.modules[name]
    importlib.invalidate_caches()


def archive(name: str) -> ModuleArchive:
    """Return the archive that a new process makes."""
    forget_imports()
    return archive_module(import_estimator(f"{MODULE}:{name}"))


def make_plan_of(*names: str) -> StudyPlan:
    estimators = {f"{MODULE}:{name}": import_estimator(f"{MODULE}:{name}") for name in names}
    return make_plan(StudyFile(methods=tuple(estimators), count=1, duration=1.5), estimators)


def test_two_classes_of_one_module_run_in_one_study(lab: Path) -> None:
    execution = StudyExecution(make_plan_of("One", "Other"), lab / "out")
    execution.run(InProcessPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
    methods = execution.gather()["method"].to_pylist()
    assert methods == [f"{MODULE}:One", f"{MODULE}:Other"]


def test_an_archive_contains_local_imports_and_its_hash_covers_them(lab: Path) -> None:
    (lab / "unrelated.py").write_text("raise SystemExit\n")
    original = archive("One")
    (lab / f"{MODULE}_helper.py").write_text(HELPER.format(factor=0.5))
    changed = archive("One")
    assert original.digest != changed.digest
    factors = [load_classes(a)[a.name]().factor() for a in (original, changed)]  # pyright: ignore
    assert factors == [1.0, 0.5]
    (lab / "unrelated.py").write_text("\n")
    assert archive("One").digest == changed.digest


def test_a_module_that_a_worker_cannot_import_raises_one_error(lab: Path) -> None:
    sent = archive("One")
    (lab / f"{MODULE}.py").write_text(f"import not_installed_here\n{SOURCE}")
    sys.modules["not_installed_here"] = sys  # installed on the machine that sends it
    incomplete = archive("One")
    del sys.modules["not_installed_here"]
    message = f"{MODULE} cannot be imported by a worker.*No module named 'not_installed_here'"
    with pytest.raises(RcmServoError, match=message):
        load_classes(incomplete)
    with pytest.raises(RcmServoError, match="the SHA-256 of its archive is not 000"):
        load_classes(sent._replace(digest="0" * 64))


def test_a_class_with_a_setting_without_default_is_rejected_by_name(lab: Path) -> None:
    with pytest.raises(BadInput, match=r"--method must be a class whose settings all have a de"):
        import_estimator(f"{MODULE}:Lacks", "--method")
