"""What is done of a study stays done, whatever happens, and is the same however it was done."""

import errno
import json
import os
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from studies import Alone, made
from studies import small as usual_study

from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.study.execution import manifest, store
from rcmservo.study.execution.chunk import OtherPackage, done
from rcmservo.study.execution.run_study import Work
from rcmservo.study.execution.store import REPORT, RUNS, SCHEMA, SUMMARY, TUNED, key_of, runs_in
from rcmservo.study.plan import plan
from rcmservo.study.plan.cell import COMPILED
from rcmservo.study.row import StudyRow

small = partial(usual_study, count=25)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten runs each, so that two methods over 25 scenes are three chunks each."""
    monkeypatch.setitem(plan.SIZES, COMPILED, 10)


def test_a_study_that_was_stopped_ends_with_the_same_bytes(tmp_path: Path) -> None:
    whole, stopped = made(small(), tmp_path / "a"), Work(small(), tmp_path / "b")
    stopped.left = dict(list(stopped.left.items())[:2])
    stopped.go(Alone(), lambda _: None)  # pyright: ignore[reportArgumentType]
    after = Work(small(), tmp_path / "b")
    assert not after.changed and after.runs_left == 50 - 20
    after.go(Alone(), lambda _: None)  # pyright: ignore[reportArgumentType]
    for work in (whole, after):
        work.gather()
    assert (tmp_path / "a" / RUNS).read_bytes() == (tmp_path / "b" / RUNS).read_bytes()


def test_progress_counts_every_run_once(tmp_path: Path) -> None:
    counted: list[int] = []
    Work(small(), tmp_path).go(Alone(), counted.append)  # pyright: ignore[reportArgumentType]
    assert sum(counted) == 50


def test_a_changed_setting_makes_anew_what_depends_on_it_and_is_told(tmp_path: Path) -> None:
    made(small(), tmp_path)
    more = Work(small(count=30), tmp_path)
    assert more.changed == ["count"] and more.runs_left == 2 * 10
    other = Work(small(methods=("dlt", "projection-printed")), tmp_path)
    assert other.changed == ["method"] and other.runs_left == 25
    longer = made(small(duration=3.0), tmp_path)
    assert "duration" in longer.changed and longer.runs_left == 50
    again = Work(small(), tmp_path)
    assert again.changed == ["duration"] and again.runs_left == 0


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"noise": (0.5,)}, ["noise"]),
        ({"latency": (0.05,)}, ["latency"]),
        ({"first_seed": 3, "shown": 7}, ["seed", "shown"]),
        ({"scenes": ("random", "laparoscopic")}, ["scenes"]),
        ({"scenes": ("paper",)}, ["scenes"]),
        ({"methods": ("dlt", "projection", "flow")}, ["method"]),
        (
            {"method": {"dlt": {"estimator": "dlt", "controller": {"gain": 3.0}}}},
            ["settings of dlt"],
        ),
        ({"engine": "mujoco"}, ["engine of dlt", "engine of projection"]),
        ({"repetitions": 2, "duration": 3.0}, ["repetitions", "duration"]),
        ({"distribution": {"random": {"vary": {"camera.point_noise": [0.1, 1.0]}}}}, ["noise"]),
        ({"distribution": {"random": {"drive": {"lag": 0.01}}}}, ["scenes"]),
    ],
)
def test_what_changed_is_told_in_the_words_of_who_changed_it(
    choices: dict[str, object], words: list[str]
) -> None:
    before, now = (
        manifest.note_of(small(count=4)),
        manifest.note_of(small(**{"count": 4, **choices})),
    )
    assert manifest.changed(before, now) == words


def test_rows_of_another_rcmservo_are_not_taken_for_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made(small(), tmp_path)
    monkeypatch.setattr(store, "package", lambda: "0.0.1 abc")
    monkeypatch.setattr(manifest, "package", lambda: "0.0.1 abc")
    work = Work(small(), tmp_path)
    assert work.changed == ["rcmservo"] and work.runs_left == 50


def test_a_worker_with_another_rcmservo_refuses(tmp_path: Path) -> None:
    work = Work(small(), tmp_path)
    orders: list[tuple[str, object]] = []

    class Keeps:
        def done(self, given: object) -> list[object]:
            orders.extend(given)  # pyright: ignore
            return []

    work.go(Keeps(), lambda _: None)  # pyright: ignore[reportArgumentType]
    order = orders[0][1]
    with pytest.raises(OtherPackage, match=r"has another rcmservo .* than this machine \(0\.0\.1"):
        done(order._replace(package="0.0.1 abc"))  # pyright: ignore


@pytest.mark.parametrize("when", ["part", "gather"])
def test_a_full_disk_is_one_sentence_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    work, written = Work(small(), tmp_path), [0]
    usual = store.PQ.write_table

    class Full:
        read_table = store.PQ.read_table

        @staticmethod
        def write_table(table: object, path: Path, **options: object) -> None:
            written[0] += 1
            if written[0] == (3 if when == "part" else 7):
                path.write_bytes(b"half")
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            usual(table, path, **options)

    words = "cannot be written: No space left on device"
    with monkeypatch.context() as full, pytest.raises(UnusableFile, match=words):
        full.setattr(store, "PQ", Full)
        work.go(Alone(), lambda _: None)  # pyright: ignore[reportArgumentType]
        work.gather()
    left = Work(small(), tmp_path)
    assert left.runs_left == (50 - 20 if when == "part" else 0)
    assert not list(tmp_path.rglob("*.part"))


def test_a_part_that_was_damaged_is_told_and_made_again(tmp_path: Path) -> None:
    work = made(small(), tmp_path)
    part = next((tmp_path / "parts").glob("*.parquet"))
    part.write_bytes(part.read_bytes()[:-20])
    with pytest.raises(UnusableFile, match="the same command makes it again"):
        work.gather()
    assert made(small(), tmp_path).gather().num_rows == 50


def test_a_folder_that_holds_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(UnusableFile, match="holds no study: name a new folder"):
        Work(small(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    (tmp_path / "mine.txt").unlink()
    made(small(count=4), tmp_path)
    (tmp_path / manifest.NAME).write_text("{}")
    with pytest.raises(UnusableFile, match="is not what `rcmservo study` wrote"):
        Work(small(count=4), tmp_path)


def test_every_row_has_every_column_with_its_meaning(tmp_path: Path) -> None:
    table = made(small(count=3), tmp_path).gather()
    assert table.column_names == [f.name for f in fields(StudyRow)]
    for column in table.schema:
        assert len(column.metadata[b"meaning"]) > 5
    assert table.schema.equals(SCHEMA) and runs_in(tmp_path).equals(table)
    assert table["method"].to_pylist() == ["dlt"] * 3 + ["projection"] * 3
    assert table["seed"].to_pylist() == [0, 1, 2] * 2
    with pytest.raises(RcmServoError, match="is not there: the study is not done yet"):
        runs_in(tmp_path / "elsewhere")
    (tmp_path / RUNS).write_bytes(b"PAR1")
    with pytest.raises(RcmServoError, match="is not the runs of a study"):
        runs_in(tmp_path)


def test_nothing_is_written_before_the_first_rows_are_there(tmp_path: Path) -> None:
    """A plan that is refused later, or stopped at once, would leave folders behind."""
    work = Work(small(count=4), tmp_path / "a" / "b")
    assert not list(tmp_path.iterdir())
    work.go(Alone(), lambda _: None)  # pyright: ignore[reportArgumentType]
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == [
        "parts",
        manifest.NAME,
    ]


def test_a_folder_that_nobody_may_write_to_is_told_before_anything_is_done(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(UnusableFile, match="cannot be written to"):
            Work(small(count=4), folder)


def test_gathered_rows_are_never_those_of_another_study_than_is_noted(tmp_path: Path) -> None:
    """One that was stopped would be replayed by the rows of the one before."""
    made(small(count=4), tmp_path).gather()
    stopped = Work(small(count=4, duration=3.0), tmp_path)
    stopped.left = dict(list(stopped.left.items())[:1])
    stopped.go(Alone(), lambda _: None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(RcmServoError, match="is not there: the study is not done yet"):
        runs_in(tmp_path)


def test_nothing_that_tells_of_other_rows_stays_beside_new_ones(tmp_path: Path) -> None:
    """A report with --no-report, numbers where the study was stopped, what a search found."""
    work, told = made(small(count=4), tmp_path), {REPORT, SUMMARY, TUNED}
    work.gather()
    for name in told:
        (tmp_path / name).write_text("of these rows")
    Work(small(count=4), tmp_path).gather()
    assert told <= {path.name for path in tmp_path.iterdir()}
    made(small(count=4, duration=3.0), tmp_path).gather()
    assert {path.name for path in tmp_path.iterdir()} == {"parts", manifest.NAME, RUNS}


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ({"count": "x"}, "study.count must be a whole number, got 'x'"),
        ({"count": 0}, "study.count must be a whole number from 1 on, got 0"),
        ({"first_seed": 1.5}, "study.first_seed must be a whole number, got 1.5"),
        ({"first_seed": -1}, "study.first_seed must be a whole number from 0 on, got -1"),
        ({"format": "other"}, "study.format must be rcmservo study 1, got 'other'"),
        ({"cells": []}, "study.cells must be one at least"),
        ({"cells": [{"method": "dlt"}]}, "study.cells[0].servo must be given"),
        ({"servo": {}}, "study.cells[0].servo.estimator must be a table with its kind, got None"),
        ({"tables": {"tool": 3}}, "study.cells[0].tables.tool must be a table, got 3"),
        ({"motor": 3}, "study.cells[0].motor must be left out"),
    ],
)
def test_a_damaged_note_is_told_by_what_is_wrong_in_it(
    tmp_path: Path, damage: dict[str, object], words: str
) -> None:
    manifest.write(tmp_path, manifest.note_of(small(count=4)))
    told = json.loads((tmp_path / manifest.NAME).read_text())
    (told if set(damage) <= set(told) else told["cells"][0]).update(damage)
    (tmp_path / manifest.NAME).write_text(json.dumps(told))
    with pytest.raises(UnusableFile) as error:
        manifest.read(tmp_path)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_any_row_can_be_made_again_from_what_the_folder_notes(tmp_path: Path) -> None:
    table = made(small(count=30, repetitions=2, noise=(0.3, 1.0)), tmp_path).gather()
    told = manifest.read(tmp_path)
    assert told is not None and told.runs == table.num_rows == 2 * 2 * 2 * 30
    for case in (0, 29, 30, 95, 239):
        cell, seed = told.run_of(case)
        row = table.slice(case, 1).to_pylist()[0]
        given = (cell.method, seed, cell.repetition, cell.tables["camera"]["point_noise"])
        assert given == (row["method"], row["seed"], row["repetition"], row["noise_px"])


def test_repetitions_are_the_same_scene_with_other_noise(tmp_path: Path) -> None:
    rows = made(small(methods=("dlt",), count=5, repetitions=3), tmp_path).gather().to_pydict()
    focal = np.array(rows["focal_px"]).reshape(3, 5)
    assert (focal == focal[0]).all() and len(set(focal[0])) == 5
    assert len(set(rows["pose_error_mm"])) == 15


def test_chunks_are_known_by_all_that_they_depend_on() -> None:
    one = [key_of(chunk) for chunk in small().chunks()]
    assert len(set(one)) == len(one) == 6
    for other in (small(shown=10), small(noise=(0.4,)), small(scenes=("paper",))):
        assert not set(one) & {key_of(chunk) for chunk in other.chunks()}
    text = json.dumps([chunk.cell.text for chunk in small().chunks()])
    assert "/" not in text.replace("://", "")  # no path of this machine
