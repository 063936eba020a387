"""`rcmservo study --replay`: one run of a study, made again, recorded, and held against its row."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rcmservo.cli.folders import new_folder
from rcmservo.cli.result_output import draw_figures, two_column_table
from rcmservo.cli.simulated_run.pictures import overlay
from rcmservo.cli.terminal import console
from rcmservo.errors import BadInput, RcmServoError, UnusableFile, require
from rcmservo.estimation.base import Estimator
from rcmservo.figures.video import VideoWriter
from rcmservo.loop.tick import Tick
from rcmservo.recording import reader
from rcmservo.recording.reader import RECORD
from rcmservo.recording.summary_text import result_rows, title_of
from rcmservo.recording.writer import Recorder
from rcmservo.servo.servo import Servo
from rcmservo.study.execution import manifest
from rcmservo.study.execution.chunk import one_run
from rcmservo.study.execution.package_version import package
from rcmservo.study.execution.store import RUNS, runs_in
from rcmservo.study.plan.cell import Cell
from rcmservo.study.plan.conditions import COMPILED, MUJOCO
from rcmservo.study.plan.user_module_archive import parcel_of
from rcmservo.study.row import StudyRow
from rcmservo.study.simulation_engine import Laboratory, LaboratoryLoop

RERUNS_FOLDER = "replays"
"""The folder of these records, in that of the study."""
ORIGIN_COLUMNS = "cpu", "versions"
"""Columns that tell where a row was made, and not what came of the run."""


def rerun_row(folder: Path | None, case: int, film: bool, own: dict[str, type[Estimator]]) -> int:
    """Make the run of a row again, and record it; 0 where it came out the same."""
    if folder is None:
        raise BadInput("--out", None, "the folder of the study, with --replay")
    made = manifest.read(folder)
    if made is None:
        raise UnusableFile(folder, "holds no study")
    require(0 <= case < made.runs, "--replay", case, f"a row from 0 to {made.runs - 1}")
    (cell, seed), before = made.run_of(case), _recorded_row(folder, made, case)
    _require_same_code(made.package, cell, own)
    servo, out = cell.rebuilt(own), console()
    made_again = one_run(cell, servo, seed)
    row = asdict(made_again)
    other = [name for name in row if row[name] != before[name] and name not in ORIGIN_COLUMNS]
    with new_folder(_unused_path(folder / RERUNS_FOLDER / str(case)), "replay") as there:
        failed = _record_run(cell, servo, seed, there, film)
    out.print(f"row {case}: {cell.method}, {cell.condition}, seed {seed}, {cell.engine}")
    out.print(two_column_table(title_of(made_again.result), _result_rows(made_again)))
    same = "the same row, bit for bit" if not other else f"not the same: {', '.join(other)}"
    elsewhere = [
        f"{name} was {before[name]}" for name in ORIGIN_COLUMNS if row[name] != before[name]
    ]
    same = f"{same} ({', '.join(elsewhere)})" if elsewhere else same
    how = ", recorded with MuJoCo's arm" if cell.engine == COMPILED else ", recorded"
    out.print(f"{same}{how} in {there}; rcmservo show {there} tells it", soft_wrap=True)
    if failed:
        out.print(failed, soft_wrap=True)
    return 1 if other else 0


def _recorded_row(folder: Path, made: manifest.StudyNote, case: int) -> dict[str, Any]:
    """The row as the study has it."""
    rows = runs_in(folder)
    if rows.num_rows != made.runs:
        why = (
            f"has {rows.num_rows} rows, and {manifest.NAME} tells of {made.runs}: name a new folder"
        )
        raise UnusableFile(folder / RUNS, why)
    return rows.slice(case, 1).to_pylist()[0]


def _result_rows(row: StudyRow) -> list[tuple[str, str]]:
    """Return the row's result as titles and words, with what only a study measures."""
    stop = "none" if row.stop_s is None else f"{row.stop} at {row.stop_s:.2f} s, of {row.stops}"
    grown = f"{row.unnoticed_mm:.3f} mm while no cause was named"
    return [*result_rows(row.result), ("first stop", stop), ("growth of the error", grown)]


def _require_same_code(made_by: str, cell: Cell, own: dict[str, type[Estimator]]) -> None:
    """Refuse to make a run again with other code than it was made with."""
    if made_by != package():
        raise RcmServoError(
            f"this study was made by another rcmservo ({made_by}) than this one ({package()}): "
            "make it anew first"
        )
    kind = str(cell.servo["estimator"]["kind"])
    if cell.source and (kind not in own or parcel_of(own[kind]).digest != cell.source):
        why = "has changed since" if kind in own else "is code of others"
        raise RcmServoError(
            f"the estimator {kind} {why}: "
            + ("make the study anew first" if kind in own else f"name it with --own {kind}")
        )


def _unused_path(path: Path) -> Path:
    """The path, or with a number after it if something is there already."""
    tries = (path.with_name(f"{path.name}-{k}") if k > 1 else path for k in range(1, 10_000))
    return next(one for one in tries if not one.exists())


def _record_run(cell: Cell, servo: Servo, seed: int, folder: Path, film: bool) -> str:
    """Make the run in the laboratory, with its record, its figures and its film; what of the film
    went wrong, in words.
    """
    engine = MUJOCO if cell.engine == COMPILED else cell.engine
    laboratory = replace(cell, engine=engine).engine_for(seed, servo)
    assert isinstance(laboratory, Laboratory)
    loop = LaboratoryLoop(laboratory, seed, cell.repetition)
    about = {"simulation": True, "seed": seed, "study": asdict(cell)}
    with ExitStack() as stack:
        recorder = stack.enter_context(Recorder(folder / RECORD, about))
        video = _open_video(folder, loop) if film else None
        recorder.begin(laboratory.servo, loop.target, None)
        filmed = _frame_writer(loop, video) if video is not None else None
        for tick in loop.ticks():
            loop.rig.truth.write(recorder, tick)
            if filmed is not None:
                filmed(tick)
        if video is not None:
            video.close()
    draw_figures(reader.read_record(folder), folder)
    return video.failed if video is not None else ""


def _open_video(folder: Path, loop: LaboratoryLoop) -> VideoWriter:
    size, rate = loop.rig.settings, loop.rig.settings.timing.frame_rate
    return VideoWriter(folder / "overlay.webm", (size.width, size.height), rate)


def _frame_writer(loop: LaboratoryLoop, video: VideoWriter) -> Callable[[Tick], None]:
    """What adds every new frame to the film. Where the camera only told points, the scene is drawn
    as a camera with pictures would have seen it then.
    """
    newest = -1

    def picture(tick: Tick) -> None:
        nonlocal newest
        if tick.seen.frame <= newest:
            return
        newest = tick.seen.frame
        frame = loop.plant.frame
        seen = None if frame is None else frame.image
        image = loop.rig.picture(tick.seen.exposure, newest) if seen is None else seen
        video.write(overlay(image, tick))

    return picture
