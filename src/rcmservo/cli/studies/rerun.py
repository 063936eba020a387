"""`rcmservo study --replay`: rerun one run of a study, record it, and compare it with its row."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rcmservo.cli.folders import open_new_folder
from rcmservo.cli.result_output import build_two_column_table, draw_figures
from rcmservo.cli.simulated_run.video import draw_tick
from rcmservo.cli.terminal import open_console
from rcmservo.errors import BadInput, RcmServoError, UnusableFile, require
from rcmservo.estimation.base import Estimator
from rcmservo.figures.video import VideoWriter
from rcmservo.loop.tick import Tick
from rcmservo.recording import reader
from rcmservo.recording.reader import RECORD
from rcmservo.recording.summary_text import format_title, list_result_rows
from rcmservo.recording.writer import Recorder
from rcmservo.servo.servo import Servo
from rcmservo.study.execution import manifest
from rcmservo.study.execution.chunk import run_seed
from rcmservo.study.execution.package_version import identify_package
from rcmservo.study.execution.store import RUNS_FILE, read_runs
from rcmservo.study.plan.cell import Cell
from rcmservo.study.plan.conditions import COMPILED, MUJOCO
from rcmservo.study.plan.user_module_archive import archive_module
from rcmservo.study.row import StudyRow
from rcmservo.study.simulation_engine import SimulationEngine, SimulationLoop

RERUNS_FOLDER = "replays"
"""Folder of these records in that of the study."""
ORIGIN_COLUMNS = "cpu", "versions"
"""Columns that describe the computer of a row and not the result of the run."""


def rerun_row(folder: Path | None, case: int, video: bool, own: dict[str, type[Estimator]]) -> int:
    """Rerun and record the run of a row; return 0 if the row is the same.

    Parameters
    ----------
    folder : Path or None
        Folder of the study.
    case : int
        Index of the row.
    video : bool
        Write a video as well.
    own : dict
        User-defined estimators by name.
    """
    if folder is None:
        raise BadInput("--out", None, "the folder of the study, with --replay")
    note = manifest.read_manifest(folder)
    if note is None:
        raise UnusableFile(folder, "holds no study")
    require(0 <= case < note.runs, "--replay", case, f"a row from 0 to {note.runs - 1}")
    (cell, seed), before = note.find_run(case), _read_row(folder, note, case)
    _require_same_code(note.package, cell, own)
    servo, out = cell.rebuild_servo(own), open_console()
    made_again = run_seed(cell, servo, seed)
    row = asdict(made_again)
    changed = [name for name in row if row[name] != before[name] and name not in ORIGIN_COLUMNS]
    with open_new_folder(_find_unused_path(folder / RERUNS_FOLDER / str(case)), "replay") as output:
        failed = _record_run(cell, servo, seed, output, video)
    out.print(f"row {case}: {cell.method}, {cell.condition}, seed {seed}, {cell.engine}")
    out.print(
        build_two_column_table(format_title(made_again.result), _list_result_rows(made_again))
    )
    outcome = (
        "the same row, bit for bit" if not changed else f"the row differs in {', '.join(changed)}"
    )
    origin = [f"{name} was {before[name]}" for name in ORIGIN_COLUMNS if row[name] != before[name]]
    outcome = f"{outcome} ({', '.join(origin)})" if origin else outcome
    recording = ", recorded with MuJoCo's arm" if cell.engine == COMPILED else ", recorded"
    out.print(
        f"{outcome}{recording} in {output}; rcmservo show {output} reports it", soft_wrap=True
    )
    if failed:
        out.print(failed, soft_wrap=True)
    return 1 if changed else 0


def _read_row(folder: Path, note: manifest.StudyManifest, case: int) -> dict[str, Any]:
    """Return a row of the study."""
    rows = read_runs(folder)
    if rows.num_rows != note.runs:
        counts = f"has {rows.num_rows} rows, but {manifest.MANIFEST_NAME} lists {note.runs}"
        raise UnusableFile(folder / RUNS_FILE, f"{counts}: name a new folder")
    return rows.slice(case, 1).to_pylist()[0]


def _list_result_rows(row: StudyRow) -> list[tuple[str, str]]:
    """Return the row's result as names and values, with those that only a study measures."""
    stop = "none" if row.stop_s is None else f"{row.stop} at {row.stop_s:.2f} s, of {row.stops}"
    grown = f"{row.unnoticed_mm:.3f} mm without a cause"
    return [*list_result_rows(row.result), ("first stop", stop), ("growth of the error", grown)]


def _require_same_code(made_by: str, cell: Cell, own: dict[str, type[Estimator]]) -> None:
    """Refuse to rerun a run with code other than that of the study."""
    if made_by != identify_package():
        raise RcmServoError(
            f"this study was made by rcmservo {made_by}, not by the present {identify_package()}: "
            "rerun the study first"
        )
    kind = str(cell.servo["estimator"]["kind"])
    if cell.source and (kind not in own or archive_module(own[kind]).digest != cell.source):
        reason = "has changed since" if kind in own else "is code of another user"
        raise RcmServoError(
            f"the estimator {kind} {reason}: "
            + ("rerun the study first" if kind in own else f"name it with --user-estimator {kind}")
        )


def _find_unused_path(path: Path) -> Path:
    """Return a path, with a number appended if it exists."""
    tries = (path.with_name(f"{path.name}-{k}") if k > 1 else path for k in range(1, 10_000))
    return next(one for one in tries if not one.exists())


def _record_run(cell: Cell, servo: Servo, seed: int, folder: Path, with_video: bool) -> str:
    """Run in the lab with record, figures and video; return the reason if the video failed."""
    engine = MUJOCO if cell.engine == COMPILED else cell.engine
    laboratory = replace(cell, engine=engine).make_engine(seed, servo)
    assert isinstance(laboratory, SimulationEngine)
    loop = SimulationLoop(laboratory, seed, cell.repetition)
    about = {"simulation": True, "seed": seed, "study": asdict(cell)}
    with ExitStack() as stack:
        recorder = stack.enter_context(Recorder(folder / RECORD, about))
        video = _open_video(folder, loop) if with_video else None
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


def _open_video(folder: Path, loop: SimulationLoop) -> VideoWriter:
    size, rate = loop.rig.settings, loop.rig.settings.timing.frame_rate
    return VideoWriter(folder / "overlay.webm", (size.width, size.height), rate)


def _frame_writer(loop: SimulationLoop, video: VideoWriter) -> Callable[[Tick], None]:
    """Return a function that adds each new frame to the video.

    If the camera delivered points only, the scene is rendered as a camera with images would see it.
    """
    newest = -1

    def write_frame(tick: Tick) -> None:
        nonlocal newest
        if tick.observation.frame <= newest:
            return
        newest = tick.observation.frame
        frame = loop.plant.frame
        image = None if frame is None else frame.image
        if image is None:
            image = loop.rig.picture(tick.observation.exposure, newest)
        video.write(draw_tick(image, tick))

    return write_frame
