"""A search finds settings that are better in scenes that it has not seen, and what it tells of them
can be used.
"""

import shlex
import sys
import warnings
from collections.abc import Generator, Iterable
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studies import Alone, made

from rcmservo.cli.cli import asked_of
from rcmservo.cli.studies.tune import run_command, settings_text
from rcmservo.config.rig_file import Lab
from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import BadInput, RcmServoError
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.projection_rule import PRINTED, ProjectionEstimator
from rcmservo.servo.user_estimator import called
from rcmservo.study.execution.chunk import ChunkOrder, Numbers, one_run
from rcmservo.study.plan.cell import cell_from
from rcmservo.study.plan.file import StudyFile, load, plan_of
from rcmservo.study.plan.method import method_of
from rcmservo.study.plan.method import tried as servo_of
from rcmservo.study.report.summary import comparisons, groups
from rcmservo.study.tuning.search import AGAIN, TUNED, Tried, Tuning, best, cost_of, searched
from rcmservo.study.tuning.space import SearchAxis, axis_from, value_of, with_values

BAD: dict[str, Any] = {
    "estimator": "dlt",
    "controller": {"gain": 0.5},
    "exploration": {"share": 0.03},
}
"""A start that is far from good."""
AXES = {
    "controller.gain": {"from": 0.3, "to": 20.0, "log": True},
    "exploration.share": [0.02, 0.5],
}
USUAL = method_of("usual", estimator=ProjectionEstimator())


@dataclass(frozen=True)
class Picky(FlowEstimator):
    """A user's own: it refuses some of its settings in its own way, and shows by its name what its
    options are called.
    """

    forgetting: float = 0.9
    name = "picky"

    def __post_init__(self) -> None:
        if self.forgetting > 0.95:
            raise ValueError("too much")


class Counting(Alone):
    """A crew of one that counts the runs that it is asked for."""

    def __init__(self) -> None:
        self.runs, self.seeds = 0, set[int]()

    def done(
        self, orders: Iterable[tuple[str, ChunkOrder]]
    ) -> Generator[tuple[str, list[Numbers]]]:
        for key, order in orders:
            self.runs += order.end - order.begin
            self.seeds |= set(range(order.begin, order.end))
            yield from super().done([(key, order)])


class Here(Alone):
    """A crew of one that has the class of this module."""

    def done(
        self, orders: Iterable[tuple[str, ChunkOrder]]
    ) -> Generator[tuple[str, list[Numbers]]]:
        for key, order in orders:
            cell = cell_from(order.cell)
            servo = cell.rebuilt({called(Picky()): Picky})
            seeds = range(order.begin, order.end)
            yield key, [astuple(one_run(cell, servo, seed)) for seed in seeds]


def tuning(
    axes: dict[str, Any] | None = None, method: dict[str, Any] | None = None, **choices: Any
) -> Tuning:
    """A search over few short runs."""
    asked = StudyFile(count=choices.pop("count", 20), duration=2.0, method={"start": method or BAD})
    plan = plan_of(replace(asked, duration=choices.pop("duration", 2.0)), {})
    told = axes or AXES
    found = tuple(axis_from(name, one, plan.methods[0]) for name, one in told.items())
    return Tuning(plan=plan, axes=found, **{"trials": 8, "validation": 40, **choices})


def tried(asked: Tuning, folder: Path, crew: Alone | None = None) -> list[Tried]:
    heard: list[Tried] = []
    found = searched(asked, folder, crew or Alone(), heard.append)  # pyright: ignore
    assert heard == found
    return found


@pytest.mark.parametrize(
    ("name", "told", "axis"),
    [
        ("controller.gain", [2, 15.0], SearchAxis("controller.gain", 2.0, 15.0)),
        ("estimator.observations", [6, 40], SearchAxis("estimator.observations", 6, 40)),
        (
            "exploration.leg",
            {"from": 0.05, "to": 0.5, "log": True},
            SearchAxis("exploration.leg", 0.05, 0.5, True),
        ),
        ("exploration.leg", {"from": -1, "to": 1}, SearchAxis("exploration.leg", -1.0, 1.0)),
        (
            "controller.features",
            ["srd", "points"],
            SearchAxis("controller.features", words=("srd", "points")),
        ),
    ],
)
def test_a_range_or_a_choice_is_read_as_it_stands(
    name: str, told: object, axis: SearchAxis
) -> None:
    found = axis_from(name, told, USUAL)
    assert found == axis and type(found.low) is type(axis.low)


@pytest.mark.parametrize(
    ("name", "told", "words"),
    [
        ("controller.gain", [15.0, 2.0], 'search."controller.gain" must be two finite numbers'),
        ("controller.gain", [2.0, 2.0], "least first"),
        ("controller.gain", [2.0], "two finite numbers"),
        ("controller.gain", [2.0, float("nan")], "two finite numbers"),
        ("controller.gain", [2.0, float("inf")], "two finite numbers"),
        ("controller.gain", [True, False], "two finite numbers"),
        ("controller.gain", [2.0, "b"], "two finite numbers"),
        ("controller.gain", {"from": 2.0}, "two finite numbers"),
        ("controller.gain", {"from": 0.0, "to": 2.0, "log": True}, "where log = true"),
        ("controller.gain", {"form": 2.0, "to": 3.0}, "must be one of from, to, log"),
        ("controller.gain", {"from": 1.0, "to": 3.0, "log": "yes"}, "must be true or false"),
        ("controller.gain", 3.0, "two numbers, least first, or a list of words"),
        ("controller.gain", [], "or a list of words"),
        ("controller.gain", ["low", "high"], "two numbers, as it is 8.0 now"),
        ("controller.features", [1, 2], "left out: it is 'srd' now, which is no number"),
        ("controller.bounds", [1.0, 2.0], "which is no number"),
        ("estimator.both_markers", [0, 1], "left out: it is True now"),
        ("estimator.observations", [6.0, 40.0], "two whole numbers, as it is 20 now"),
        ("controller.gian", [1.0, 2.0], "did you mean controller.gain?"),
        ("gate.speed", [1.0, 2.0], "a box among estimator, controller"),
        ("gain", [1.0, 2.0], "box.name"),
    ],
)
def test_what_cannot_be_searched_is_one_sentence(name: str, told: object, words: str) -> None:
    with pytest.raises(BadInput) as error:
        axis_from(name, told, USUAL)
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"trials": 0}, "tune.trials must be a whole number from 1"),
        ({"validation": 9}, "tune.validation must be a whole number from 10"),
        ({"goal": "speed"}, "tune.goal must be one of time, error"),
        ({"seed": -1}, "tune.seed must be"),
        ({"axes": ()}, "search must be a setting at least"),
    ],
)
def test_a_search_that_cannot_be_is_one_sentence(choices: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        replace(tuning(), **choices)


def test_values_are_put_where_their_names_say_and_nowhere_else() -> None:
    values = {"controller.gain": 3.0, "controller.features": "points", "estimator.rate": 2.0}
    method = with_values(USUAL, "new", values)
    assert {name: value_of(method, name) for name in values} == values
    assert method.parts["exploration"] == USUAL.parts["exploration"] and method.name == "new"
    before = replace(method.parts["controller"], gain=8.0, features="srd")
    assert before == USUAL.parts["controller"]
    assert value_of(USUAL, "controller.gain") == 8.0


def test_runs_that_fail_cost_as_much_as_is_said(tmp_path: Path) -> None:
    """A run that never came, and one that came and left again, as well."""
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
        assert cost_of(tuning(goal=goal), rows) == pytest.approx(cost)


def test_the_same_seed_is_the_same_search_and_nothing_is_done_twice(tmp_path: Path) -> None:
    asked, first, second, other = tuning(), Counting(), Counting(), Counting()
    found = tried(asked, tmp_path / "a", first)
    assert first.runs == len(found) * asked.plan.runs == 8 * 20
    assert len({tuple(one.values.values()) for one in found}) == 8
    stopped = tried(replace(asked, trials=3), tmp_path / "b")
    assert stopped == found[:3]
    assert tried(asked, tmp_path / "b", second) == found and second.runs == 5 * 20
    assert tried(asked, tmp_path / "a", other) == found and other.runs == 0
    assert tried(replace(asked, seed=1), tmp_path / "a")[1:] != found[1:]


def test_the_first_trial_is_the_start_also_where_the_ranges_leave_it_out(tmp_path: Path) -> None:
    """Optuna would warn, or refuse a word that is not among the others."""
    axes = {"controller.gain": [2.0, 15.0], "controller.features": ["points", "size"]}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = tried(tuning(axes, trials=3, count=5), tmp_path)
    assert dict(found[0].values) == {"controller.gain": 0.5, "controller.features": "srd"}
    assert all(2.0 <= one.values["controller.gain"] <= 15.0 for one in found[1:])
    assert np.isfinite(found[0].cost)


def test_a_search_is_tried_on_scenes_that_it_has_not_seen(tmp_path: Path) -> None:
    asked, crew = tuning(trials=2, count=7), Counting()
    tried(asked, tmp_path, crew)
    unseen = asked.unseen
    beyond = set(range(unseen.first_seed, unseen.first_seed + unseen.count))
    assert crew.seeds == set(range(7)) and len(beyond) == 40 and not crew.seeds & beyond


def test_settings_that_do_not_go_together_cost_all_and_end_nothing(tmp_path: Path) -> None:
    """Half of this range is refused by the law itself."""
    found = tried(tuning({"controller.gain": [-20.0, 20.0]}, trials=8, count=5), tmp_path)
    refused = [one for one in found if one.values["controller.gain"] <= 0.0]
    assert len(found) == 8 and refused and all(one.cost == np.inf for one in refused)
    assert best(found).cost < np.inf


def test_a_users_own_estimator_may_refuse_in_its_own_way(tmp_path: Path) -> None:
    asked = tuning(count=1, trials=6)
    plan = replace(asked.plan, methods=(method_of("own", estimator=Picky()),), duration=1.1)
    axes = (axis_from("estimator.forgetting", [0.9, 1.0], plan.methods[0]),)
    found = tried(replace(asked, plan=plan, axes=axes), tmp_path, Here())
    refused = [one.cost == np.inf for one in found]
    assert refused == [one.values["estimator.forgetting"] > 0.95 for one in found]
    assert any(refused) and not all(refused)


def test_the_first_of_equal_trials_is_the_best() -> None:
    trials = [Tried(0, {}, 3.0, 1.0), Tried(1, {}, 2.0, 1.0), Tried(2, {}, 2.0, 1.0)]
    assert best(trials).number == 1


def test_from_a_bad_start_a_search_finds_what_is_better_in_scenes_that_it_has_not_seen(
    tmp_path: Path,
) -> None:
    asked = tuning(trials=12, count=20, duration=6.0, validation=60)
    found = best(tried(asked, tmp_path / "search"))
    start = asked.plan.methods[0]
    method = with_values(start, TUNED, found.values)
    plan = replace(asked.unseen, methods=(start, method))
    (told,) = comparisons(groups(plan, made(plan, tmp_path / "unseen").gather()))
    assert told.success.low > 0.3 and told.time_s.high < -1.0


METHODS = {
    "gain": method_of(
        "tuned",
        estimator=ProjectionEstimator(),
        controller=SaturatedController(gain=17.16936316628802),
    ),
    "words, lists and whole numbers": method_of(
        "tuned",
        estimator=ProjectionEstimator(observations=33, both_markers=False, gamma="printed"),
        controller=SaturatedController(features="points", bounds=(0.7, 1e-3, 123456.789)),
        exploration=Exploration(leg=1 / 3, legs=4),
    ),
    "a preset": method_of("tuned", estimator=PRINTED),
}


def options_of(command: str) -> Any:
    words = shlex.split(command)
    assert words[0] == "rcmservo"
    return asked_of(words[1], words[2:])


@pytest.mark.parametrize("case", METHODS)
def test_the_command_that_is_printed_runs_these_very_settings(case: str) -> None:
    options = options_of(run_command(METHODS[case]))
    assert options.servo == servo_of(METHODS[case], Lab())


def test_the_command_with_a_users_own_estimator_calls_its_settings_as_its_options_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "lab_of_mine", sys.modules[__name__])
    monkeypatch.setattr(Picky, "__module__", "lab_of_mine")
    method = method_of("tuned", estimator=Picky(forgetting=0.91))
    options = options_of(run_command(method))
    assert options.estimator == "lab_of_mine:Picky"
    assert options.servo.estimator == method.estimator


@pytest.mark.parametrize("case", METHODS)
def test_what_was_found_is_a_study_file_that_gives_it_back(case: str, tmp_path: Path) -> None:
    (tmp_path / "tuned.toml").write_text(settings_text(METHODS[case], {}, tuning()))
    assert plan_of(load(tmp_path / "tuned.toml"), {}).methods == (METHODS[case],)


def test_what_was_found_of_a_users_own_estimator_names_it(tmp_path: Path) -> None:
    method, own = method_of("tuned", estimator=Picky(forgetting=0.91)), {"lab_of_mine:Picky": Picky}
    (tmp_path / "tuned.toml").write_text(settings_text(method, own, tuning()))
    assert plan_of(load(tmp_path / "tuned.toml"), own).methods == (method,)
    with pytest.raises(RcmServoError, match="lab_of_mine:Picky"):
        plan_of(load(tmp_path / "tuned.toml"), {})


def test_a_search_may_start_at_what_one_before_has_found() -> None:
    """Two methods with one name cannot be compared, which would be told after the search only."""
    asked = tuning()
    start = replace(asked.plan.methods[0], name=TUNED)
    again = replace(asked, plan=replace(asked.plan, methods=(start,)))
    assert (asked.name, again.name) == (TUNED, AGAIN)
