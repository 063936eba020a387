"""Execution of a study: finished chunks persist, and an interrupted study gives the same rows."""

import errno
import json
import os
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from studies import InProcessPool, run_plan
from studies import make_small_plan as make_default_plan

from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.study.execution import manifest, store
from rcmservo.study.execution.chunk import PackageMismatch, run_chunk
from rcmservo.study.execution.run_study import StudyExecution
from rcmservo.study.execution.store import (
    REPORT_FILE,
    RUNS_FILE,
    SCHEMA,
    SUMMARY_FILE,
    TUNED_FILE,
    compute_chunk_key,
    read_runs,
)
from rcmservo.study.plan import plan
from rcmservo.study.plan.cell import COMPILED
from rcmservo.study.row import StudyRow

make_plan = partial(make_default_plan, count=25)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set chunks of ten runs, so that two methods over 25 scenes are three chunks each."""
    monkeypatch.setitem(plan.CHUNK_SIZES, COMPILED, 10)


def test_an_interrupted_study_ends_with_the_same_bytes(tmp_path: Path) -> None:
    complete = run_plan(make_plan(), tmp_path / "a")
    interrupted = StudyExecution(make_plan(), tmp_path / "b")
    interrupted.missing = dict(list(interrupted.missing.items())[:2])
    interrupted.run(InProcessPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
    resumed = StudyExecution(make_plan(), tmp_path / "b")
    assert not resumed.changed_settings and resumed.missing_runs == 50 - 20
    resumed.run(InProcessPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
    for execution in (complete, resumed):
        execution.gather()
    assert (tmp_path / "a" / RUNS_FILE).read_bytes() == (tmp_path / "b" / RUNS_FILE).read_bytes()


def test_progress_counts_every_run_once(tmp_path: Path) -> None:
    finished: list[int] = []
    StudyExecution(make_plan(), tmp_path).run(InProcessPool(), finished.append)  # pyright: ignore[reportArgumentType]
    assert sum(finished) == 50


def test_a_changed_setting_is_listed_and_invalidates_the_runs_that_depend_on_it(
    tmp_path: Path,
) -> None:
    run_plan(make_plan(), tmp_path)
    extended = StudyExecution(make_plan(count=30), tmp_path)
    assert extended.changed_settings == ["count"] and extended.missing_runs == 2 * 10
    new_method = StudyExecution(make_plan(methods=("dlt", "projection-printed")), tmp_path)
    assert new_method.changed_settings == ["method"] and new_method.missing_runs == 25
    longer = run_plan(make_plan(duration=3.0), tmp_path)
    assert "duration" in longer.changed_settings and longer.missing_runs == 50
    restored = StudyExecution(make_plan(), tmp_path)
    assert restored.changed_settings == ["duration"] and restored.missing_runs == 0


@pytest.mark.parametrize(
    ("settings", "changed"),
    [
        ({"noise": (0.5,)}, ["noise"]),
        ({"latency": (0.05,)}, ["latency"]),
        ({"first_seed": 3, "teaching_frames": 7}, ["seed", "teaching frames"]),
        ({"scenes": ("random", "laparoscopic")}, ["scenes"]),
        ({"scenes": ("paper",)}, ["scenes"]),
        ({"methods": ("dlt", "projection", "projection-printed")}, ["method"]),
        (
            {"methods": ("dlt", "projection", "flow")},
            ["method", "engine of dlt", "engine of projection"],
        ),
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
def test_changed_settings_have_the_names_of_options_and_files(
    settings: dict[str, object], changed: list[str]
) -> None:
    earlier = manifest.make_manifest(make_plan(count=4))
    present = manifest.make_manifest(make_plan(**{"count": 4, **settings}))
    assert manifest.list_changed_settings(earlier, present) == changed


def test_rows_of_another_rcmservo_are_not_reused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_plan(make_plan(), tmp_path)
    monkeypatch.setattr(store, "identify_package", lambda: "0.0.1 abc")
    monkeypatch.setattr(manifest, "identify_package", lambda: "0.0.1 abc")
    execution = StudyExecution(make_plan(), tmp_path)
    assert execution.changed_settings == ["rcmservo"] and execution.missing_runs == 50


def test_a_worker_with_another_rcmservo_rejects_a_request(tmp_path: Path) -> None:
    execution = StudyExecution(make_plan(), tmp_path)
    requests: list[tuple[str, object]] = []

    class RecordingPool:
        def run(self, new_requests: object) -> list[object]:
            requests.extend(new_requests)  # pyright: ignore
            return []

    execution.run(RecordingPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
    request = requests[0][1]
    with pytest.raises(
        PackageMismatch, match=r"has another rcmservo .* than this machine \(0\.0\.1"
    ):
        run_chunk(request._replace(package="0.0.1 abc"))  # pyright: ignore


@pytest.mark.parametrize("when", ["part", "gather"])
def test_a_full_disk_raises_one_error_and_loses_no_chunk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    execution, written = StudyExecution(make_plan(), tmp_path), [0]
    write = store.PQ.write_table

    class FullDisk:
        read_table = store.PQ.read_table

        @staticmethod
        def write_table(table: object, path: Path, **options: object) -> None:
            written[0] += 1
            if written[0] == (3 if when == "part" else 7):
                path.write_bytes(b"half")
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            write(table, path, **options)

    message = "cannot be written: No space left on device"
    with monkeypatch.context() as patch, pytest.raises(UnusableFile, match=message):
        patch.setattr(store, "PQ", FullDisk)
        execution.run(InProcessPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
        execution.gather()
    resumed = StudyExecution(make_plan(), tmp_path)
    assert resumed.missing_runs == (50 - 20 if when == "part" else 0)
    assert not list(tmp_path.rglob("*.part"))


def test_a_damaged_part_raises_an_error_and_is_replaced(tmp_path: Path) -> None:
    execution = run_plan(make_plan(), tmp_path)
    part = next((tmp_path / "parts").glob("*.parquet"))
    part.write_bytes(part.read_bytes()[:-20])
    with pytest.raises(UnusableFile, match="run the same command again to replace it"):
        execution.gather()
    assert run_plan(make_plan(), tmp_path).gather().num_rows == 50


def test_a_folder_with_other_content_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(UnusableFile, match="holds no study: name a new folder"):
        StudyExecution(make_plan(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    (tmp_path / "mine.txt").unlink()
    run_plan(make_plan(count=4), tmp_path)
    (tmp_path / manifest.MANIFEST_NAME).write_text("{}")
    with pytest.raises(UnusableFile, match="is not a manifest of `rcmservo study`"):
        StudyExecution(make_plan(count=4), tmp_path)


def test_every_row_has_every_column_with_its_meaning(tmp_path: Path) -> None:
    table = run_plan(make_plan(count=3), tmp_path).gather()
    assert table.column_names == [f.name for f in fields(StudyRow)]
    for column in table.schema:
        assert len(column.metadata[b"meaning"]) > 5
    assert table.schema.equals(SCHEMA) and read_runs(tmp_path).equals(table)
    assert table["method"].to_pylist() == ["dlt"] * 3 + ["projection"] * 3
    assert table["seed"].to_pylist() == [0, 1, 2] * 2
    with pytest.raises(RcmServoError, match="does not exist: the study is not complete"):
        read_runs(tmp_path / "elsewhere")
    (tmp_path / RUNS_FILE).write_bytes(b"PAR1")
    with pytest.raises(RcmServoError, match="is not a table of the runs of a study"):
        read_runs(tmp_path)


def test_nothing_is_written_before_the_first_rows(tmp_path: Path) -> None:
    """Otherwise a plan that is rejected later, or stopped at once, would leave empty folders."""
    execution = StudyExecution(make_plan(count=4), tmp_path / "a" / "b")
    assert not list(tmp_path.iterdir())
    execution.run(InProcessPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == [
        "parts",
        manifest.MANIFEST_NAME,
    ]


def test_a_folder_without_write_access_is_rejected_before_the_first_run(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(UnusableFile, match="cannot be written to"):
            StudyExecution(make_plan(count=4), folder)


def test_gathered_rows_always_belong_to_the_study_of_the_manifest(tmp_path: Path) -> None:
    """Otherwise a stopped study would be replayed with the rows of the previous one."""
    run_plan(make_plan(count=4), tmp_path).gather()
    stopped = StudyExecution(make_plan(count=4, duration=3.0), tmp_path)
    stopped.missing = dict(list(stopped.missing.items())[:1])
    stopped.run(InProcessPool(), lambda _: None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(RcmServoError, match="does not exist: the study is not complete"):
        read_runs(tmp_path)


def test_files_made_from_old_rows_are_removed_with_them(tmp_path: Path) -> None:
    """They are a report, numbers, and the settings found by a search."""
    execution, derived = (
        run_plan(make_plan(count=4), tmp_path),
        {REPORT_FILE, SUMMARY_FILE, TUNED_FILE},
    )
    execution.gather()
    for name in derived:
        (tmp_path / name).write_text("of these rows")
    StudyExecution(make_plan(count=4), tmp_path).gather()
    assert derived <= {path.name for path in tmp_path.iterdir()}
    run_plan(make_plan(count=4, duration=3.0), tmp_path).gather()
    assert {path.name for path in tmp_path.iterdir()} == {
        "parts",
        manifest.MANIFEST_NAME,
        RUNS_FILE,
    }


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"count": "x"}, "study.count must be a whole number, got 'x'"),
        ({"count": 0}, "study.count must be a whole number from 1 on, got 0"),
        ({"first_seed": 1.5}, "study.first_seed must be a whole number, got 1.5"),
        ({"first_seed": -1}, "study.first_seed must be a whole number from 0 on, got -1"),
        ({"format": "other"}, "study.format must be rcmservo study 1, got 'other'"),
        ({"cells": []}, "study.cells must be a list with at least one cell"),
        ({"cells": [{"method": "dlt"}]}, "study.cells[0].servo must be given"),
        ({"servo": {}}, "study.cells[0].servo.estimator must be a table with its kind, got None"),
        ({"tables": {"tool": 3}}, "study.cells[0].tables.tool must be a table, got 3"),
        ({"motor": 3}, "study.cells[0].motor must be left out"),
    ],
)
def test_a_damaged_manifest_raises_an_error_that_names_the_field(
    tmp_path: Path, damage: dict[str, object], message: str
) -> None:
    manifest.write_manifest(tmp_path, manifest.make_manifest(make_plan(count=4)))
    content = json.loads((tmp_path / manifest.MANIFEST_NAME).read_text())
    (content if set(damage) <= set(content) else content["cells"][0]).update(damage)
    (tmp_path / manifest.MANIFEST_NAME).write_text(json.dumps(content))
    with pytest.raises(UnusableFile) as error:
        manifest.read_manifest(tmp_path)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_the_manifest_describes_the_run_of_every_row(tmp_path: Path) -> None:
    table = run_plan(make_plan(count=30, repetitions=2, noise=(0.3, 1.0)), tmp_path).gather()
    recorded = manifest.read_manifest(tmp_path)
    assert recorded is not None and recorded.runs == table.num_rows == 2 * 2 * 2 * 30
    for case in (0, 29, 30, 95, 239):
        cell, seed = recorded.find_run(case)
        row = table.slice(case, 1).to_pylist()[0]
        described = (cell.method, seed, cell.repetition, cell.tables["camera"]["point_noise"])
        assert described == (row["method"], row["seed"], row["repetition"], row["noise_px"])


def test_a_manifest_with_former_names_is_read(tmp_path: Path) -> None:
    plan = make_plan(teaching_frames=7, count=4)
    manifest.write_manifest(tmp_path, manifest.make_manifest(plan))
    file = tmp_path / manifest.MANIFEST_NAME
    table = json.loads(file.read_text())
    for cell in table["cells"]:
        cell["shown"] = cell.pop("teaching_frames")
        cell["tables"] |= {"look": {"read_noise": 3.0}, "thresholds": {"jump": 41.0}}
        cell["vary"] = {"look.read_noise": [1.0, 2.0]}
        thresholds, exploration = cell["servo"]["thresholds"], cell["servo"]["exploration"]
        thresholds["jump"] = thresholds.pop("max_jump_px")
        exploration["share"] = exploration.pop("speed_scale")
    file.write_text(json.dumps(table))
    read = manifest.read_manifest(tmp_path)
    assert read is not None
    for cell, expected in zip(read.cells, plan.cells, strict=True):
        assert cell.teaching_frames == 7
        assert cell.rebuild_servo({}) == expected.rebuild_servo({})
        rig, settings = cell.distribution.draw(0)
        assert rig.thresholds.max_jump_px == 41.0 and 1.0 <= settings.appearance.read_noise <= 2.0


def test_repetitions_have_the_same_scene_and_other_noise(tmp_path: Path) -> None:
    rows = (
        run_plan(make_plan(methods=("dlt",), count=5, repetitions=3), tmp_path).gather().to_pydict()
    )
    focal = np.array(rows["focal_px"]).reshape(3, 5)
    assert (focal == focal[0]).all() and len(set(focal[0])) == 5
    assert len(set(rows["pose_error_mm"])) == 15


def test_the_key_of_a_chunk_depends_on_all_its_inputs() -> None:
    keys = [compute_chunk_key(chunk) for chunk in make_plan().chunks()]
    assert len(set(keys)) == len(keys) == 6
    for other in (
        make_plan(teaching_frames=10),
        make_plan(noise=(0.4,)),
        make_plan(scenes=("paper",)),
    ):
        assert not set(keys) & {compute_chunk_key(chunk) for chunk in other.chunks()}
    text = json.dumps([chunk.cell.text for chunk in make_plan().chunks()])
    assert "/" not in text.replace("://", "")  # no path of this machine
