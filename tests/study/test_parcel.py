"""A user's own module travels whole: with what it imports from its folder, however many of its
classes are tried, and it is known by all of that.
"""

import importlib
import sys
from collections.abc import Generator
from pathlib import Path

import pytest
from studies import Alone

from rcmservo.config.user_code import named
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.study.execution.run_study import Work
from rcmservo.study.plan.file import StudyFile, plan_of
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.plan.user_module_archive import Parcel, classes, parcel_of

MODULE = "lab_of_parcels"
HELPER = "SHARE = {share}\n"
SOURCE = """
from dataclasses import dataclass
import lab_of_parcels_helper
import rcmservo as rs
from rcmservo.estimation.flow_rule import FlowEstimator

@dataclass(frozen=True)
class One(FlowEstimator):
    name = "one"
    def share(self):
        return lab_of_parcels_helper.SHARE

@dataclass(frozen=True)
class Other(FlowEstimator):
    name = "other"

@dataclass(frozen=True, kw_only=True)
class Lacks(FlowEstimator):
    needed: float
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Path]:
    """A folder with a user's module and another one that it imports."""
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    (tmp_path / f"{MODULE}_helper.py").write_text(HELPER.format(share=1.0))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    forget()


def forget() -> None:
    """Be a process that has imported none of it."""
    sys.path[:] = [place for place in sys.path if "rcmservo-" not in place]
    for name in [name for name in sys.modules if name.startswith(MODULE)]:
        del sys.modules[name]
    importlib.invalidate_caches()


def parcel(name: str) -> Parcel:
    """As a new command makes it."""
    forget()
    return parcel_of(named(f"{MODULE}:{name}"))


def planned(*names: str) -> StudyPlan:
    own = {f"{MODULE}:{name}": named(f"{MODULE}:{name}") for name in names}
    return plan_of(StudyFile(methods=tuple(own), count=1, duration=1.5), own)


def test_two_classes_of_one_module_are_compared(lab: Path) -> None:
    work = Work(planned("One", "Other"), lab / "out")
    work.go(Alone(), lambda _: None)  # pyright: ignore[reportArgumentType]
    methods = work.gather()["method"].to_pylist()
    assert methods == [f"{MODULE}:One", f"{MODULE}:Other"]


def test_a_module_travels_with_what_it_imports_from_its_folder_and_is_known_by_it(
    lab: Path,
) -> None:
    (lab / "unrelated.py").write_text("raise SystemExit\n")
    before = parcel("One")
    (lab / f"{MODULE}_helper.py").write_text(HELPER.format(share=0.5))
    after = parcel("One")
    assert before.digest != after.digest
    shares = [classes(one)[one.name]().share() for one in (before, after)]  # pyright: ignore
    assert shares == [1.0, 0.5]
    (lab / "unrelated.py").write_text("\n")
    assert parcel("One").digest == after.digest


def test_what_a_worker_cannot_import_is_one_sentence(lab: Path) -> None:
    sent = parcel("One")
    (lab / f"{MODULE}.py").write_text(f"import not_installed_here\n{SOURCE}")
    sys.modules["not_installed_here"] = sys  # where it is sent from it is installed
    lacking = parcel("One")
    del sys.modules["not_installed_here"]
    words = f"{MODULE} cannot be imported by a worker.*No module named 'not_installed_here'"
    with pytest.raises(RcmServoError, match=words):
        classes(lacking)
    with pytest.raises(RcmServoError, match="its hash is another one"):
        classes(sent._replace(digest="0" * 64))


def test_a_class_that_cannot_be_made_is_refused_by_its_name(lab: Path) -> None:
    with pytest.raises(BadInput, match=r"--method must be a class whose settings all have a de"):
        named(f"{MODULE}:Lacks", "--method")
