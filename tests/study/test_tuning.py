"""Search for settings: they are better on scenes outside the search, and its output can be used."""

import shlex
import sys
import warnings
from collections.abc import Generator, Iterable
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studies import InProcessPool, run_plan

from rcmservo.cli.cli import parse_command_options
from rcmservo.cli.studies.tune import format_run_command, format_settings
from rcmservo.config.rig_file import RigDescription
from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR, ProjectionEstimator
from rcmservo.servo.user_estimator import format_class_name_of
from rcmservo.study.execution.chunk import ChunkRequest, RowValues, run_seed
from rcmservo.study.plan.cell import parse_cell
from rcmservo.study.plan.file import StudyFile, make_plan, read_study_file
from rcmservo.study.plan.method import make_method
from rcmservo.study.plan.method import make_servo as servo_of
from rcmservo.study.report.summary import compare_with_first, group_runs
from rcmservo.study.tuning.search import (
    RETUNED_METHOD,
    TUNED_METHOD,
    SearchTrial,
    Tuning,
    compute_cost,
    find_best_trial,
    run_search,
)
from rcmservo.study.tuning.space import SearchAxis, get_setting, parse_axis, replace_settings

BAD_START: dict[str, Any] = {
    "estimator": "dlt",
    "controller": {"gain": 0.5},
    "exploration": {"speed_scale": 0.03},
}
"""Initial method with poor settings."""
AXES = {
    "controller.gain": {"from": 0.3, "to": 20.0, "log": True},
    "exploration.speed_scale": [0.02, 0.5],
}
DEFAULT_METHOD = make_method("default", estimator=ProjectionEstimator())


@dataclass(frozen=True)
class Picky(FlowEstimator):
    """User-defined estimator that rejects some settings with an exception of its own.

    Its name is also the prefix of its options.
    """

    forgetting: float = 0.9
    name = "picky"

    def __post_init__(self) -> None:
        if self.forgetting > 0.95:
            raise ValueError("too much")


class CountingPool(InProcessPool):
    """Pool in this process that counts the requested runs."""

    def __init__(self) -> None:
        self.runs, self.seeds = 0, set[int]()

    def run(
        self, requests: Iterable[tuple[str, ChunkRequest]]
    ) -> Generator[tuple[str, list[RowValues]]]:
        for key, request in requests:
            self.runs += len(request.seeds)
            self.seeds |= set(request.seeds)
            yield from super().run([(key, request)])


class LocalClassPool(InProcessPool):
    """Pool in this process that knows the estimator class of this module."""

    def run(
        self, requests: Iterable[tuple[str, ChunkRequest]]
    ) -> Generator[tuple[str, list[RowValues]]]:
        for key, request in requests:
            cell = parse_cell(request.cell)
            servo = cell.rebuild_servo({format_class_name_of(Picky()): Picky})
            yield key, [astuple(run_seed(cell, servo, seed)) for seed in request.seeds]


def make_tuning(
    axes: dict[str, Any] | None = None, method: dict[str, Any] | None = None, **settings: Any
) -> Tuning:
    """Return a search over few short runs."""
    file = StudyFile(
        count=settings.pop("count", 20),
        duration=settings.pop("duration", 2.0),
        method={"start": method or BAD_START},
    )
    plan = make_plan(file, {})
    entries = (axes or AXES).items()
    parsed = tuple(parse_axis(name, entry, plan.methods[0]) for name, entry in entries)
    return Tuning(plan=plan, axes=parsed, **{"trials": 8, "validation": 40, **settings})


def run_small_search(
    tuning: Tuning, folder: Path, pool: InProcessPool | None = None
) -> list[SearchTrial]:
    reported: list[SearchTrial] = []
    trials = run_search(tuning, folder, pool or InProcessPool(), reported.append)  # pyright: ignore
    assert reported == trials
    return trials


@pytest.mark.parametrize(
    ("name", "entry", "axis"),
    [
        ("controller.gain", [2, 15.0], SearchAxis("controller.gain", 2.0, 15.0)),
        ("estimator.observations", [6, 40], SearchAxis("estimator.observations", 6, 40)),
        (
            "exploration.leg_time",
            {"from": 0.05, "to": 0.5, "log": True},
            SearchAxis("exploration.leg_time", 0.05, 0.5, True),
        ),
        (
            "exploration.leg_time",
            {"from": -1, "to": 1},
            SearchAxis("exploration.leg_time", -1.0, 1.0),
        ),
        (
            "controller.features",
            ["srd", "points"],
            SearchAxis("controller.features", choices=("srd", "points")),
        ),
    ],
)
def test_a_range_or_a_set_of_choices_becomes_an_axis(
    name: str, entry: object, axis: SearchAxis
) -> None:
    parsed = parse_axis(name, entry, DEFAULT_METHOD)
    assert parsed == axis and type(parsed.low) is type(axis.low)


@pytest.mark.parametrize(
    ("name", "entry", "message"),
    [
        ("controller.gain", [15.0, 2.0], 'search."controller.gain" must be two finite numbers'),
        ("controller.gain", [2.0, 2.0], "least first"),
        ("controller.gain", [2.0], "two finite numbers"),
        ("controller.gain", [2.0, float("nan")], "two finite numbers"),
        ("controller.gain", [2.0, float("inf")], "two finite numbers"),
        ("controller.gain", [True, False], "two finite numbers"),
        ("controller.gain", [2.0, "b"], "two finite numbers"),
        ("controller.gain", {"from": 2.0}, "two finite numbers"),
        ("controller.gain", {"from": 0.0, "to": 2.0, "log": True}, "for log = true"),
        ("controller.gain", {"form": 2.0, "to": 3.0}, "must be one of from, to, log"),
        ("controller.gain", {"from": 1.0, "to": 3.0, "log": "yes"}, "must be true or false"),
        ("controller.gain", 3.0, "two numbers, least first, or a list of words"),
        ("controller.gain", [], "or a list of words"),
        ("controller.gain", ["low", "high"], "two numbers, as it is 8.0 now"),
        ("controller.features", [1, 2], "left out: it is 'srd' now, which is not a number"),
        ("controller.bounds", [1.0, 2.0], "which is not a number"),
        ("estimator.both_markers", [0, 1], "left out: it is True now"),
        ("estimator.observations", [6.0, 40.0], "two whole numbers, as it is 20 now"),
        ("controller.gian", [1.0, 2.0], "did you mean controller.gain?"),
        ("gate.speed", [1.0, 2.0], "a part among estimator, controller"),
        ("gain", [1.0, 2.0], "part.name"),
    ],
)
def test_an_invalid_axis_raises_one_error_that_names_it(
    name: str, entry: object, message: str
) -> None:
    with pytest.raises(BadInput) as error:
        parse_axis(name, entry, DEFAULT_METHOD)
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"trials": 0}, "tune.trials must be a whole number from 1"),
        ({"validation": 9}, "tune.validation must be a whole number from 10"),
        ({"goal": "speed"}, "tune.goal must be one of time, error"),
        ({"seed": -1}, "tune.seed must be"),
        ({"axes": ()}, "search must be at least one setting"),
    ],
)
def test_an_invalid_search_raises_an_error_that_names_the_field(
    settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(BadInput, match=message):
        replace(make_tuning(), **settings)


def test_values_replace_only_the_settings_that_they_name() -> None:
    values = {"controller.gain": 3.0, "controller.features": "points", "estimator.rate": 2.0}
    method = replace_settings(DEFAULT_METHOD, "new", values)
    assert {name: get_setting(method, name) for name in values} == values
    assert (
        method.parts["exploration"] == DEFAULT_METHOD.parts["exploration"] and method.name == "new"
    )
    before = replace(method.parts["controller"], gain=8.0, features="srd")
    assert before == DEFAULT_METHOD.parts["controller"]
    assert get_setting(DEFAULT_METHOD, "controller.gain") == 8.0


def test_failed_runs_have_a_fixed_cost() -> None:
    """A run fails without arrival, and also if it arrives and departs."""
    import pyarrow as pa

    arrow: Any = pa
    rows = arrow.table(
        {
            "success": [True, False, False, True],
            "time_to_1mm_s": [1.5, None, 1.0, 2.5],
            "pose_error_mm": [0.1, 60.0, 1.5, 0.3],
        }
    )
    for goal, cost in (
        ("time", (1.5 + 4.0 + 4.0 + 2.5) / 4.0),
        ("error", (0.1 + 20.0 + 0.3) / 4.0),
    ):
        assert compute_cost(make_tuning(goal=goal), rows) == pytest.approx(cost)


def test_the_same_seed_repeats_the_search_without_repeating_runs(tmp_path: Path) -> None:
    tuning, first, second, third = make_tuning(), CountingPool(), CountingPool(), CountingPool()
    trials = run_small_search(tuning, tmp_path / "a", first)
    assert first.runs == len(trials) * tuning.plan.runs == 8 * 20
    assert len({tuple(trial.values.values()) for trial in trials}) == 8
    stopped = run_small_search(replace(tuning, trials=3), tmp_path / "b")
    assert stopped == trials[:3]
    assert run_small_search(tuning, tmp_path / "b", second) == trials and second.runs == 5 * 20
    assert run_small_search(tuning, tmp_path / "a", third) == trials and third.runs == 0
    assert run_small_search(replace(tuning, seed=1), tmp_path / "a")[1:] != trials[1:]


def test_the_first_trial_has_the_initial_settings_even_outside_the_ranges(tmp_path: Path) -> None:
    """Optuna would warn, or reject a string that is not among the choices."""
    axes = {"controller.gain": [2.0, 15.0], "controller.features": ["points", "size"]}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trials = run_small_search(make_tuning(axes, trials=3, count=5), tmp_path)
    assert dict(trials[0].values) == {"controller.gain": 0.5, "controller.features": "srd"}
    assert all(2.0 <= trial.values["controller.gain"] <= 15.0 for trial in trials[1:])
    assert np.isfinite(trials[0].cost)


def test_the_validation_uses_scenes_outside_the_search(tmp_path: Path) -> None:
    tuning, pool = make_tuning(trials=2, count=7), CountingPool()
    run_small_search(tuning, tmp_path, pool)
    plan = tuning.validation_plan
    validation = set(range(plan.first_seed, plan.first_seed + plan.count))
    assert pool.seeds == set(range(7)) and len(validation) == 40 and not pool.seeds & validation


def test_invalid_settings_have_infinite_cost_and_do_not_end_the_search(tmp_path: Path) -> None:
    """The controller rejects half of this range."""
    tuning = make_tuning({"controller.gain": [-20.0, 20.0]}, trials=8, count=5)
    trials = run_small_search(tuning, tmp_path)
    rejected = [trial for trial in trials if trial.values["controller.gain"] <= 0.0]
    assert len(trials) == 8 and rejected and all(trial.cost == np.inf for trial in rejected)
    assert find_best_trial(trials).cost < np.inf


def test_a_user_estimator_may_reject_settings_with_any_exception(tmp_path: Path) -> None:
    tuning = make_tuning(count=1, trials=6)
    plan = replace(tuning.plan, methods=(make_method("own", estimator=Picky()),), duration=1.1)
    axes = (parse_axis("estimator.forgetting", [0.9, 1.0], plan.methods[0]),)
    trials = run_small_search(replace(tuning, plan=plan, axes=axes), tmp_path, LocalClassPool())
    rejected = [trial.cost == np.inf for trial in trials]
    assert rejected == [trial.values["estimator.forgetting"] > 0.95 for trial in trials]
    assert any(rejected) and not all(rejected)


def test_the_first_of_equal_trials_is_the_best() -> None:
    trials = [
        SearchTrial(0, {}, 3.0, 1.0),
        SearchTrial(1, {}, 2.0, 1.0),
        SearchTrial(2, {}, 2.0, 1.0),
    ]
    assert find_best_trial(trials).number == 1


def test_a_search_improves_poor_settings_on_scenes_outside_the_search(tmp_path: Path) -> None:
    tuning = make_tuning(trials=12, count=20, duration=6.0, validation=60)
    trial = find_best_trial(run_small_search(tuning, tmp_path / "search"))
    start = tuning.plan.methods[0]
    method = replace_settings(start, TUNED_METHOD, trial.values)
    plan = replace(tuning.validation_plan, methods=(start, method))
    (comparison,) = compare_with_first(
        group_runs(plan, run_plan(plan, tmp_path / "unseen").gather())
    )
    assert comparison.success.low > 0.3 and comparison.time_s.high < -1.0


METHODS = {
    "gain": make_method(
        "tuned",
        estimator=ProjectionEstimator(),
        controller=SaturatedController(gain=17.16936316628802),
    ),
    "strings, lists and integers": make_method(
        "tuned",
        estimator=ProjectionEstimator(observations=33, both_markers=False, gamma="printed"),
        controller=SaturatedController(features="points", bounds=(0.7, 1e-3, 123456.789)),
        exploration=Exploration(leg_time=1 / 3, min_corners=4),
    ),
    "a preset": make_method("tuned", estimator=PAPER_PROJECTION_ESTIMATOR),
}


def parse_command(command: str) -> Any:
    words = shlex.split(command)
    assert words[0] == "rcmservo"
    return parse_command_options(words[1], words[2:])


@pytest.mark.parametrize("case", METHODS)
def test_the_printed_command_runs_exactly_these_settings(case: str) -> None:
    options = parse_command(format_run_command(METHODS[case]))
    assert options.servo == servo_of(METHODS[case], RigDescription())


def test_the_printed_command_has_the_option_names_of_a_user_estimator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "user_lab", sys.modules[__name__])
    monkeypatch.setattr(Picky, "__module__", "user_lab")
    method = make_method("tuned", estimator=Picky(forgetting=0.91))
    options = parse_command(format_run_command(method))
    assert options.estimator == "user_lab:Picky"
    assert options.servo.estimator == method.estimator


@pytest.mark.parametrize("case", METHODS)
def test_the_written_settings_are_a_study_file_with_the_same_method(
    case: str, tmp_path: Path
) -> None:
    (tmp_path / "tuned.toml").write_text(format_settings(METHODS[case], {}, make_tuning()))
    assert make_plan(read_study_file(tmp_path / "tuned.toml"), {}).methods == (METHODS[case],)


def test_the_written_settings_of_a_user_estimator_name_its_class(tmp_path: Path) -> None:
    method, own = make_method("tuned", estimator=Picky(forgetting=0.91)), {"user_lab:Picky": Picky}
    (tmp_path / "tuned.toml").write_text(format_settings(method, own, make_tuning()))
    assert make_plan(read_study_file(tmp_path / "tuned.toml"), own).methods == (method,)
    with pytest.raises(RcmServoError, match="user_lab:Picky"):
        make_plan(read_study_file(tmp_path / "tuned.toml"), {})


def test_a_search_from_the_result_of_a_search_has_another_name() -> None:
    """Two methods with one name cannot be compared, which would raise an error after the search."""
    first = make_tuning()
    start = replace(first.plan.methods[0], name=TUNED_METHOD)
    second = replace(first, plan=replace(first.plan, methods=(start,)))
    assert (first.method_name, second.method_name) == (TUNED_METHOD, RETUNED_METHOD)
