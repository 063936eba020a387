"""Tasks of the experiments: run once, completely or not at all, and continued after a stop."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_tasks import count, counted, fail, not_measured, settled

import rcmservo
from rcmservo.paper import potential_claims
from rcmservo.paper import run as running
from rcmservo.paper.experiment import Experiment
from rcmservo.paper.plan import Measurement, NotMeasured, Results, Settings, Task
from rcmservo.paper.run import run, run_all, select_experiments
from rcmservo.paper.store import (
    PART_SUFFIX,
    RESULT_FILE,
    Assignment,
    fingerprint,
    from_json,
    imported_paper_files,
    to_json,
)


def runs(log: Path) -> list[str]:
    return sorted(log.read_text().split())


def nothing(task: Task) -> None:
    del task


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run tasks in a thread, because new processes need a second for imports."""
    monkeypatch.setattr(running, "ProcessPoolExecutor", lambda *_, **__: ThreadPoolExecutor(1))


@pytest.mark.usefixtures("in_this_process")
def test_finished_tasks_are_not_repeated_unless_they_change(tmp_path: Path) -> None:
    log, out = tmp_path / "log", tmp_path / "out"
    first, _ = run_all(counted(log, "a", "b"), out, nothing)
    assert first["some"]["a"] == {"name": "a"}
    assert (first["some"].folders["b"] / "made.txt").read_text() == "b"
    run_all(counted(log, "a", "b", "c"), out, nothing)
    assert runs(log) == ["a", "b", "c"]
    changed = counted(log, "a", "b")
    changed["some"][0] = Task("a", partial(count, log=log, name="other"), in_folder=True)
    assert run_all(changed, out, nothing)[0]["some"]["a"] == {"name": "other"}
    assert runs(log) == ["a", "b", "c", "other"]


def test_a_stopped_run_continues_with_unfinished_tasks(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Tasks run in processes until the stop."""
    log, out = tmp_path / "log", tmp_path / "out"

    def stop(task: Task) -> None:
        raise KeyboardInterrupt

    names = [f"task-{i}" for i in range(8)]
    with pytest.raises(KeyboardInterrupt):
        run_all(counted(log, *names), out, stop)
    finished = [
        path.parent.name
        for path in out.glob(f"some/*/{RESULT_FILE}")
        if not path.parent.name.endswith(PART_SUFFIX)
    ]
    assert finished
    assert all(
        json.loads((out / "some" / name / RESULT_FILE).read_text())["values"]["name"] == name
        for name in finished
    )
    before = runs(log)
    request.getfixturevalue("in_this_process")
    results, _ = run_all(counted(log, *names), out, nothing)
    assert set(results["some"].by_task) == set(names)
    assert all(runs(log).count(name) == before.count(name) for name in finished)


@pytest.mark.usefixtures("in_this_process")
def test_a_task_that_fails_leaves_no_result(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="this task fails"):
        run_all({"some": [Task("bad", partial(fail), in_folder=True)]}, tmp_path, nothing)
    assert not (tmp_path / "some" / "bad").exists()


@pytest.mark.usefixtures("in_this_process")
def test_only_a_damaged_result_is_computed_again(tmp_path: Path) -> None:
    log = tmp_path / "log"
    damage = dict(zip("abcde", ["", "{", "[]", '{"fingerprint": 3}', "null"], strict=True))
    tasks = counted(log, *damage, "whole")
    run_all(tasks, tmp_path / "out", nothing)
    for name, text in damage.items():
        (tmp_path / "out" / "some" / name / RESULT_FILE).write_text(text)
    done = run_all(tasks, tmp_path / "out", nothing)[0]["some"]
    assert all(done[name] == {"name": name} for name in damage)
    assert runs(log) == sorted([*damage, *damage, "whole"])


def test_an_incomplete_result_is_discarded(tmp_path: Path) -> None:
    log = tmp_path / "log"
    task = counted(log, "a")["some"][0]
    part = tmp_path / ("a" + PART_SUFFIX)
    part.mkdir()
    (part / "old.txt").write_text("old")
    Assignment(task, tmp_path / "a", fingerprint(task)).perform()
    assert not part.exists()
    assert not (tmp_path / "a" / "old.txt").exists()


def test_a_fingerprint_depends_on_every_setting() -> None:
    one, same, other = (
        Task("a", partial(settled, settings=Settings(n=n))) for n in (1.0, 1.0, 1.0 + 1e-15)
    )
    assert fingerprint(one) == fingerprint(same)
    assert fingerprint(one) != fingerprint(other)
    assert fingerprint(one) != fingerprint(Task("a", partial(fail)))


def test_a_fingerprint_depends_only_on_the_module_of_the_experiment_and_its_imports() -> None:
    root = Path(rcmservo.__file__).parent
    module = root / "paper/regulation_flow_claims.py"
    names = {path.stem for path in imported_paper_files(root, module)}
    assert names >= {"regulation_flow_claims", "regulation", "closed_loop", "paper_settings"}
    assert not names & {"showing_claims", "potential_claims", "report", "paper"}


def test_a_result_survives_a_round_trip_through_json() -> None:
    given = {
        "number": 1.0 / 3.0,
        "word": "word",
        "maybe": None,
        "series": np.array([1.0, np.nan]),
        "nested": [{"number": 0.1, "words": ["", "a"]}, {"number": 2, "words": []}],
    }
    got = from_json(json.loads(json.dumps(to_json(given), allow_nan=False)))
    np.testing.assert_array_equal(got.pop("series"), given.pop("series"))
    assert got["nested"][1].pop("words").size == 0
    del given["nested"][1]["words"]  # pyright: ignore[reportArgumentType, reportOptionalSubscript, reportIndexIssue, reportUnknownMemberType]
    assert got == given


def test_a_series_with_gaps_is_an_array() -> None:
    got = from_json(json.loads("[[1, null], [0.5, 3]]"))
    np.testing.assert_array_equal(got, [[1.0, np.nan], [0.5, 3.0]])


@pytest.mark.usefixtures("in_this_process")
def test_equal_tasks_of_two_experiments_run_once(tmp_path: Path) -> None:
    log = tmp_path / "log"
    plans = {"one": counted(log, "a")["some"], "two": counted(log, "a")["some"]}
    advanced = list[Task]()
    results, _ = run_all(plans, tmp_path / "out", advanced.append)
    assert runs(log) == ["a"] and len(advanced) == 2
    for name in plans:
        assert results[name]["a"] == {"name": "a"}
        assert (results[name].folders["a"] / "made.txt").read_text() == "a"
    run_all(plans, tmp_path / "out", nothing)
    assert runs(log) == ["a"]


def test_two_experiments_share_their_servo_runs() -> None:
    for quick in (True, False):
        marks = [
            {task.name: fingerprint(task) for task in one.plan(quick)}
            for name, one in select_experiments(None).items()
            if name in ("jacobian-accuracy", "camera-knowledge")
        ]
        servo = marks[1].keys()
        assert len(servo) >= 1
        assert {name: marks[0][name] for name in servo} == marks[1]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float64("nan")])
def test_the_error_of_a_number_that_is_not_finite_names_it(value: float) -> None:
    with pytest.raises(NotMeasured, match=r"result.inner\[1\].number: measured (nan|inf)"):
        to_json({"series": np.full(1, np.nan), "inner": [{"number": 1.0}, {"number": value}]})


@pytest.mark.usefixtures("in_this_process")
def test_a_task_without_a_measurement_fails_only_its_experiment(tmp_path: Path) -> None:
    log = tmp_path / "log"
    tasks = [Task("bad", partial(not_measured)), *counted(log, "c")["some"]]
    results, failed = run_all({"bad": tasks, **counted(log, "a", "b")}, tmp_path, nothing)
    assert failed == {"bad": "bad.number: measured nan, which is not a finite number"}
    assert not (tmp_path / "bad" / "bad").exists() and (tmp_path / "bad" / "c").exists()
    assert set(results) == {"some"} and set(results["some"].by_task) == {"a", "b"}


def unmeasured(settings: Settings, results: Results) -> Iterator[Measurement]:
    raise NotMeasured("the distance", float("nan"))
    yield


@pytest.mark.slow
def test_the_report_names_experiments_that_it_leaves_out(tmp_path: Path) -> None:
    """Either a task or the evaluation of its results fails."""

    def failing_tasks(settings: Settings) -> list[Task]:
        return [Task("bad", partial(not_measured))]

    draw: Any = potential_claims.draw
    failing = {
        "tasks": Experiment("potential", failing_tasks, potential_claims.measure, draw),
        "judging": Experiment("potential", potential_claims.tasks, unmeasured, draw),
    }
    written = run(tmp_path, True, {**select_experiments("potential"), **failing}, nothing)
    assert set(written.left_out) == {"tasks", "judging"}
    page = written.page.read_text()
    assert "Left out: tasks." in page and "the distance: measured nan" in page
    assert {row.experiment for row in written.rows} == {"potential"}
