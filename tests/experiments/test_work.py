"""Tasks of the experiments: done once, whole or not at all, and gone on with where they stopped."""

import json
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
from pydantic import TypeAdapter
from small_tasks import Counted, Setting, count, counted, fail, not_measured, settled

from rcmservo.experiments.harness import paper, work
from rcmservo.experiments.harness.claims import Chapter, NotMeasured
from rcmservo.experiments.harness.paper import EXPERIMENTS, run
from rcmservo.experiments.harness.plain import JsonFloats, built, plain
from rcmservo.experiments.harness.report import claims_in
from rcmservo.experiments.harness.tasks import Results, Task
from rcmservo.experiments.harness.work import (
    PART,
    RESULT,
    Assignment,
    fingerprint,
    perform,
    run_all,
    used,
)


def runs(log: Path) -> list[str]:
    return sorted(log.read_text().split())


def nothing(task: Task) -> None:
    del task


def test_what_is_done_is_not_repeated_and_what_changed_is(tmp_path: Path) -> None:
    log, out = tmp_path / "log", tmp_path / "out"
    first = run_all(counted(log, "a", "b"), out, nothing).results
    assert first["some"].of(Counted, "a") == Counted("a")
    assert (first["some"].folder("b") / "made.txt").read_text() == "b"
    run_all(counted(log, "a", "b", "c"), out, nothing)
    assert runs(log) == ["a", "b", "c"]
    changed = counted(log, "a", "b")
    changed["some"][0] = Task("a", partial(count, log=log, name="other"))
    assert run_all(changed, out, nothing).results["some"].of(Counted, "a") == Counted("other")
    assert runs(log) == ["a", "b", "c", "other"]


def test_a_run_that_is_stopped_goes_on_where_it_stopped(tmp_path: Path) -> None:
    log, out = tmp_path / "log", tmp_path / "out"

    def stop(task: Task) -> None:
        raise KeyboardInterrupt

    names = [f"task-{i}" for i in range(8)]
    with pytest.raises(KeyboardInterrupt):
        run_all(counted(log, *names), out, stop)
    kept = [
        path.parent.name
        for path in out.glob(f"some/*/{RESULT}")
        if not path.parent.name.endswith(PART)
    ]
    assert kept
    assert all(
        json.loads((out / "some" / name / RESULT).read_text())["values"]["name"] == name
        for name in kept
    )
    before = runs(log)
    results = run_all(counted(log, *names), out, nothing).results
    assert set(results["some"].made) == set(names)
    assert all(runs(log).count(name) == before.count(name) for name in kept)


def test_a_task_that_fails_leaves_no_result(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="this task fails"):
        run_all({"some": [Task("bad", partial(fail))]}, tmp_path, nothing)
    assert not (tmp_path / "some" / "bad").exists()


def test_a_damaged_result_is_made_again_and_no_other(tmp_path: Path) -> None:
    log = tmp_path / "log"
    damage = dict(zip("abcde", ["", "{", "[]", '{"fingerprint": 3}', "null"], strict=True))
    tasks = counted(log, *damage, "whole")
    run_all(tasks, tmp_path / "out", nothing)
    for name, text in damage.items():
        (tmp_path / "out" / "some" / name / RESULT).write_text(text)
    done = run_all(tasks, tmp_path / "out", nothing).results["some"]
    assert all(done.of(Counted, name) == Counted(name) for name in damage)
    assert runs(log) == sorted([*damage, *damage, "whole"])


def test_what_a_task_left_half_done_is_not_taken_for_its_result(tmp_path: Path) -> None:
    log = tmp_path / "log"
    task = counted(log, "a")["some"][0]
    part = tmp_path / ("a" + PART)
    part.mkdir()
    (part / "old.txt").write_text("old")
    perform(Assignment(task, tmp_path / "a", fingerprint(task)))
    assert not part.exists()
    assert not (tmp_path / "a" / "old.txt").exists()


def test_a_fingerprint_depends_on_every_setting() -> None:
    one, same, other = (
        Task("a", partial(settled, settings=Setting(n))) for n in (1.0, 1.0, 1.0 + 1e-15)
    )
    assert fingerprint(one) == fingerprint(same)
    assert fingerprint(one) != fingerprint(other)
    assert fingerprint(one) != fingerprint(replace(one, work=partial(fail)))


def test_a_fingerprint_depends_on_the_experiments_own_and_imported_files_and_on_no_other() -> None:
    root = Path(work.__file__).parents[2]
    module = root / "experiments/regulation_flow.py"
    names = {path.stem for path in used(root, module)}
    assert names >= {"regulation_flow", "regulation", "closed_loop"}
    assert not names & {"showing", "potential", "report", "paper"}


@dataclass(frozen=True)
class Everything:
    number: float
    word: str
    maybe: float | None
    series: JsonFloats = field(compare=False)
    pair: tuple[int, str]
    inner: list[Setting]
    by_name: dict[str, Setting]


def test_a_result_comes_back_from_json_as_it_was() -> None:
    inner = [Setting(0.1), Setting(2.0)]
    given = Everything(
        1.0 / 3.0, "word", None, np.array([1.0, np.nan]), (3, "x"), inner, {"a": Setting(7.0)}
    )
    got = built(Everything, json.loads(json.dumps(plain(given), allow_nan=False)))
    np.testing.assert_array_equal(got.series, given.series)
    assert got == given


def test_a_result_that_an_earlier_version_wrote_can_be_read() -> None:
    text = '{"number": 1, "word": "w", "maybe": 2.5, "series": [[1, null], [0.5, 3]],'
    text += ' "pair": [3, "x"], "inner": [{"number": 0.1}], "by_name": {"a": {"number": 7.0}}}'
    got = built(Everything, json.loads(text))
    assert (got.number, got.maybe, got.pair) == (1.0, 2.5, (3, "x"))
    assert (got.inner, got.by_name) == ([Setting(0.1)], {"a": Setting(7.0)})
    np.testing.assert_array_equal(got.series, [[1.0, np.nan], [0.5, 3.0]])


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_results_of_every_experiment_can_be_read(name: str) -> None:
    tasks = paper.tasks_of(paper.chosen(name, None), quick=True)[name]
    kinds = {get_type_hints(task.work.func)["return"] for task in tasks}
    assert kinds and all(TypeAdapter(kind).core_schema for kind in kinds)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float64("nan")])
def test_a_number_that_is_not_finite_fails_its_task_and_leaves_no_result(
    value: float, tmp_path: Path
) -> None:
    with pytest.raises(NotMeasured, match=r"result.inner\[1\].number: measured (nan|inf)"):
        plain(Everything(1.0, "", None, np.zeros(1), (1, ""), [Setting(), Setting(value)], {}))


def test_a_task_that_measured_nothing_fails_its_experiment_and_no_other(tmp_path: Path) -> None:
    log = tmp_path / "log"
    bad = [Task("bad", partial(not_measured)), *counted(log, "c")["some"]]
    done = run_all({"bad": bad, **counted(log, "a", "b")}, tmp_path, nothing)
    assert done.unmeasured == {"bad": "bad.number: measured nan, which is not a finite number"}
    assert not (tmp_path / "bad" / "bad").exists() and (tmp_path / "bad" / "c").exists()
    assert set(done.results) == {"some"} and set(done.results["some"].made) == {"a", "b"}


def unmeasured(settings: object, results: Results) -> Chapter:
    raise NotMeasured("how far it is", float("nan"))


@pytest.mark.slow
def test_what_could_not_be_measured_is_left_out_of_the_report_which_says_so(tmp_path: Path) -> None:
    """Whether a task fails or the judging of its results."""
    good = EXPERIMENTS["potential"]
    failing = {
        "tasks": replace(good, name="tasks", tasks=lambda _: [Task("bad", partial(not_measured))]),
        "judging": replace(good, name="judging", chapter=unmeasured),
    }
    written = run(tmp_path, True, {"potential": good, **failing}, nothing)
    assert set(written.left_out) == {"tasks", "judging"}
    page = written.page.read_text()
    assert "Left out: tasks." in page and "how far it is: measured nan" in page
    assert {row.experiment for row in claims_in(tmp_path)} == {"potential"}
