"""A user-defined estimator in the comparison of methods of `rcmservo paper`."""

import importlib.util
from dataclasses import replace
from typing import Any

import pytest

from conftest import ROOT
from rcmservo.cli.cli import main
from rcmservo.cli.paper import PaperOptions
from rcmservo.cli.servo_options import add_user_estimator_options
from rcmservo.paper import baselines_claims
from rcmservo.paper.lab.methods import UserEstimatorMethod
from rcmservo.paper.run import select_experiments
from rcmservo.paper.store import fingerprint


def recursive_least_squares() -> Any:
    """Return the estimator of the example."""
    path = ROOT / "examples/02_own_estimator.py"
    spec = importlib.util.spec_from_file_location("own_estimator_of_the_example", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.RLS()


@pytest.fixture
def own() -> UserEstimatorMethod:
    return UserEstimatorMethod("mylab.rls:RLS", "RLS", recursive_least_squares(), source="a hash")


def test_the_estimator_is_a_method_in_both_kinds_of_scenes(own: UserEstimatorMethod) -> None:
    for quick in (True, False):
        tasks, usual = (
            {task.name for task in select_experiments("baselines", one)["baselines"].plan(quick)}
            for one in (own, None)
        )
        assert tasks - usual == {"own-accepted", "own-rejected"}
    assert select_experiments(None, own).keys() == select_experiments(None).keys()


def test_the_estimator_moves_the_tool_to_the_target(own: UserEstimatorMethod) -> None:
    runs = baselines_claims.run_in_scenes("accepted", own, scenes=1, duration=6.0)
    assert runs["middle"][0] > 5.0 and runs["pose"][0] < 1.0 and runs["explored"][0] < 2.0


def test_a_different_source_or_setting_invalidates_the_result(own: UserEstimatorMethod) -> None:
    others = (own, replace(own, source="another hash"), replace(own, estimator=None))
    marks = {
        fingerprint(task)
        for one in others
        for task in select_experiments("baselines", one)["baselines"].plan(True)
        if task.name == "own-accepted"
    }
    assert len(marks) == 3


def test_the_command_accepts_only_user_defined_estimators(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["paper", "--only", "baselines", "--estimator", "flow", "--out", "x"]) == 2
    assert "--estimator must be your own estimator, as module:class" in capsys.readouterr().err


def test_the_settings_of_the_estimator_are_options(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = type(recursive_least_squares())
    monkeypatch.setattr("rcmservo.cli.servo_options.import_estimator", lambda name: kind)
    options = add_user_estimator_options(PaperOptions, ["--estimator", "mylab.rls:RLS"])
    made = options(estimator="mylab.rls:RLS", pixels=kind(forgetting=0.9))
    assert getattr(made, made.USER_GROUPS["mylab.rls:RLS"]).forgetting == 0.9
