"""`rcmservo study --replay`: rerun one run of a study, record it, and compare it with its row.

A study stores one row of numbers per run and no record. A rerun makes the record, and verifies that
the same code gives the same numbers.
"""

from contextlib import ExitStack
from dataclasses import asdict, replace
from itertools import chain, count
from pathlib import Path
from typing import Any

from rcmservo.cli.simulated_run.video import draw_servo_state, open_video
from rcmservo.cli.terminal import build_two_column_table, open_console
from rcmservo.config.new_folder import open_new_folder
from rcmservo.errors import BadInput, RcmServoError, UnusableFile, require
from rcmservo.estimation.base import Estimator
from rcmservo.interfaces import Image
from rcmservo.loop.tick import Tick
from rcmservo.recording import reader
from rcmservo.recording.reader import RECORD
from rcmservo.recording.writer import Recorder
from rcmservo.rig.result import draw_figures
from rcmservo.servo.servo import Servo
from rcmservo.study.execution import manifest
from rcmservo.study.execution.chunk import run_seed
from rcmservo.study.execution.package_version import identify_package
from rcmservo.study.execution.store import RUNS_FILE, read_runs
from rcmservo.study.plan.cell import Cell
from rcmservo.study.plan.conditions import COMPILED, MUJOCO
from rcmservo.study.plan.user_module_archive import archive_module
from rcmservo.study.row import format_success, list_row_texts
from rcmservo.study.simulation_engine import SimulationEngine, SimulationLoop

RERUNS_FOLDER = "replays"
"""Folder in that of the study that holds the records of such runs."""
ORIGIN_COLUMNS = "cpu", "versions"
"""Columns that describe the computer of a row and not the result of the run."""


def rerun_row(
    folder: Path | None, index: int, with_video: bool, user_estimators: dict[str, type[Estimator]]
) -> int:
    """Rerun and record the run of a row; return 0 if the row is the same.

    Parameters
    ----------
    folder : Path or None
        Folder of the study.
    index : int
        Index of the row.
    with_video : bool
        Write a video as well.
    user_estimators : dict
        User-defined estimators by name.
    """
    if folder is None:
        raise BadInput("--out", None, "the folder of the study, with --replay")
    study = manifest.read_manifest(folder)
    if study is None:
        raise UnusableFile(folder, "holds no study")
    require(0 <= index < study.runs, "--replay", index, f"a row from 0 to {study.runs - 1}")
    (cell, seed), stored = study.find_run(index), _read_row(folder, study, index)
    _require_same_code(study.package, cell, user_estimators)
    servo, console = cell.rebuild_servo(user_estimators), open_console()
    new_row = run_seed(cell, servo, seed)
    differing = [name for name, value in asdict(new_row).items() if value != stored[name]]
    with open_new_folder(
        _find_unused_path(folder / RERUNS_FOLDER / str(index)), "replay"
    ) as output:
        video_failure = _record_run(cell, servo, seed, output, with_video)
    console.print(f"row {index}: {cell.method}, {cell.condition}, seed {seed}, {cell.engine}")
    console.print(build_two_column_table(format_success(new_row), list_row_texts(new_row)))
    changed = [name for name in differing if name not in ORIGIN_COLUMNS]
    outcome = f"the row differs in {', '.join(changed)}" if changed else "the same row, bit for bit"
    origin = [f"{name} was {stored[name]}" for name in ORIGIN_COLUMNS if name in differing]
    if origin:
        outcome += f" ({', '.join(origin)})"
    engine = " with MuJoCo's arm" if cell.engine == COMPILED else ""
    hint = f"recorded{engine} in {output}; rcmservo show {output} reports it"
    console.print(f"{outcome}, {hint}", soft_wrap=True)
    if video_failure:
        console.print(video_failure, soft_wrap=True)
    return 1 if changed else 0


def _read_row(folder: Path, study: manifest.StudyManifest, index: int) -> dict[str, Any]:
    """Return a row of the study by column."""
    rows = read_runs(folder)
    if rows.num_rows != study.runs:
        counts = f"has {rows.num_rows} rows, but {manifest.MANIFEST_NAME} lists {study.runs}"
        raise UnusableFile(folder / RUNS_FILE, f"{counts}: name a new folder")
    return rows.slice(index, 1).to_pylist()[0]


def _require_same_code(
    study_package: str, cell: Cell, user_estimators: dict[str, type[Estimator]]
) -> None:
    """Refuse to rerun a run with code other than that of the study."""
    if study_package != identify_package():
        raise RcmServoError(
            f"this study was made by rcmservo {study_package}, not by the present "
            f"{identify_package()}: rerun the study first"
        )
    name = str(cell.servo["estimator"]["kind"])
    if not cell.source:
        return
    if name not in user_estimators:
        next_step = f"name it with --user-estimator {name}"
        raise RcmServoError(f"the estimator {name} is code of another user: {next_step}")
    if archive_module(user_estimators[name]).digest != cell.source:
        raise RcmServoError(f"the estimator {name} has changed since: rerun the study first")


def _find_unused_path(path: Path) -> Path:
    """Return a path, with a number appended if it exists."""
    numbered = (path.with_name(f"{path.name}-{number}") for number in count(2))
    return next(candidate for candidate in chain([path], numbered) if not candidate.exists())


def _record_run(cell: Cell, servo: Servo, seed: int, folder: Path, with_video: bool) -> str:
    """Run with record, figures and video in a folder; return the reason if the video failed."""
    engine_name = MUJOCO if cell.engine == COMPILED else cell.engine
    engine = replace(cell, engine=engine_name).make_engine(seed, servo)
    assert isinstance(engine, SimulationEngine)
    loop = SimulationLoop(engine, seed, cell.repetition)
    description = {"simulation": True, "seed": seed, "study": asdict(cell)}
    newest_frame = -1
    with ExitStack() as stack:
        recorder = stack.enter_context(Recorder(folder / RECORD, description))
        video = open_video(stack, folder, loop.rig.settings, 1) if with_video else None
        recorder.begin(engine.servo, loop.target, None)
        for tick in loop.ticks():
            loop.rig.truth.record_tick(recorder, tick)
            if video is not None and tick.observation.frame > newest_frame:
                newest_frame = tick.observation.frame
                video.write(draw_servo_state(_get_image(loop, tick), tick))
    draw_figures(reader.read_record(folder), folder)
    return video.failed if video is not None else ""


def _get_image(loop: SimulationLoop, tick: Tick) -> Image:
    """Return the camera's newest image, or a rendered one if the camera delivers points only."""
    frame = loop.plant.frame
    if frame is not None and frame.image is not None:
        return frame.image
    return loop.rig.picture(tick.observation.exposure, tick.observation.frame)
