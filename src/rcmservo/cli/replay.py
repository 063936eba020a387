"""`rcmservo replay`: score a recording, or recompute the decisions of a recorded run.

A recording is a folder of images with the joints of each image, of any arm. The record of a run is
what `rcmservo run`, `live` or `serve` wrote, with every decision of the servo.
"""

import json
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from rcmservo.cli.score_report import convert_score_to_json, format_centres_csv, print_score
from rcmservo.cli.servo_options import OptionalEstimator, ServoOptions
from rcmservo.cli.terminal import open_console
from rcmservo.config.atomic_files import write_atomically
from rcmservo.config.class_registry import ESTIMATORS, find_class_name
from rcmservo.config.new_folder import open_new_folder
from rcmservo.config.rig_file import load_rig_file
from rcmservo.errors import UnusableFile, require
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR
from rcmservo.geometry.tool import Tool
from rcmservo.hardware.device_kinds import make_tracker
from rcmservo.recording.foreign import scoring
from rcmservo.recording.reader import Record
from rcmservo.recording.replay import ReplayResult, rebuild_stage_servo, replay_record
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import check_estimator, guard_strictly

EXIT_DECISIONS_DIFFER = 1
"""Exit code of a replay in which a decision differs from the recorded one."""


@dataclass(frozen=True)
class ReplayOptions(ServoOptions):
    """Score recorded frames and joints with tracking, features, imaged RCM and the estimators.

    For a recorded run, replay recomputes every decision instead, with the recorded settings except
    for those given here. It reports whether the decisions are equal bit for bit, and if not, where
    they differ.

    Parameters
    ----------
    path : Path
        Folder with frames/ and poses.csv, or a run's folder or .mcap file.
    estimator : OptionalEstimator
        For a run: an estimator in place of the recorded one. For a recording all are scored.
    rig : Path or None
        TOML file that describes the recorded arm: mechanism, tool and markers. By default the
        built-in one.
    out : Path or None
        New or empty folder for replay.json and centres.csv; by default nothing is written.
    json : bool
        Print one JSON object on stdout and nothing else.
    """

    path: Annotated[Path, tyro.conf.Positional]
    estimator: OptionalEstimator = None
    rig: Path | None = None
    out: Path | None = None
    json: bool = False


def replay(options: ReplayOptions) -> int:
    """Score a recording and return the exit code 0."""
    if not options.path.exists():
        raise UnusableFile(options.path, "does not exist")
    console = open_console(stderr=options.json)
    with nullcontext() if options.out is None else open_new_folder(options.out, "replay") as folder:
        score = _score_recording(options, console)
        if options.json:
            print(json.dumps(convert_score_to_json(score)))
        else:
            print_score(console, score)
        if folder is not None:
            text = json.dumps(convert_score_to_json(score), indent=2) + "\n"
            write_atomically(folder / "replay.json", text)
            write_atomically(folder / "centres.csv", format_centres_csv(score))
    return 0


def _score_recording(options: ReplayOptions, console: Console) -> scoring.RecordingScore:
    """Return the score of a recording; show a progress bar while its frames are tracked."""
    lab = load_rig_file(options.rig)
    estimators = _select_estimators(options, lab.tool)
    name = TextColumn("tracking", markup=False)
    count = TextColumn("{task.completed}/{task.total} frames", markup=False)
    with Progress(name, BarColumn(), count, console=console, transient=True) as bar:
        task = bar.add_task("tracking", total=None)
        return scoring.score_recording(
            options.path,
            lab,
            make_tracker(lab),
            estimators,
            options.part_settings["imaged_rcm"],
            lambda done, total: bar.update(task, completed=done, total=total),
        )


def _select_estimators(options: ReplayOptions, tool: Tool) -> dict[str, Estimator]:
    """Return the estimators to score: the built-in ones and the one that the options name."""
    name, user_estimators = options.estimator, options.user_estimators
    expected = "left out for a recording, where all built-in ones are scored, or module:class"
    require(name is None or name in user_estimators, "--estimator", name, expected)
    selected = {key: e for key, e in options.estimators.items() if key not in user_estimators}
    if name is not None:
        check_estimator(user_estimators[name], tool)
        selected[name] = guard_strictly(user_estimators[name])
    return selected


def recompute_run(options: ReplayOptions, recorded: ReplayOptions, record: Record) -> int:
    """Recompute the decisions of a recorded run; return 1 if any of them differs.

    Parameters
    ----------
    options : ReplayOptions
        Recorded settings, with those of the command line in their place.
    recorded : ReplayOptions
        Recorded settings.
    record : Record
        Record of the run.
    """
    expected = "left out for a run, whose record describes the rig"
    require(options.rig is None, "--rig", options.rig, expected)
    require(options.out is None, "--out", options.out, "left out for a run, which writes nothing")
    has_changes = options != replace(recorded, json=options.json)
    changed_servo = _change_servo(options, record) if has_changes else None
    result = replay_record(record, changed_servo, _list_user_classes(options))
    if options.json:
        print(json.dumps(result.numbers))
    else:
        print("; ".join(filter(None, (result.sentence, record.missing))))
        if result.open_loop and not result.same:
            _print_differences(open_console(), result)
    return 0 if result.same else EXIT_DECISIONS_DIFFER


def rebuild_recorded_options(options: ReplayOptions, record: Record) -> ReplayOptions:
    """Return the recorded settings of a run as options of this command.

    The recorded estimator replaces the settings of its class. An exception is the estimator
    `projection-printed`, which has the class of `projection`: if the command line names
    `projection`, the recorded settings are not used.
    """
    servo = _rebuild_servo(options, record)
    name = find_class_name(servo.estimator, ESTIMATORS)
    groups = {part: getattr(servo, part) for part in options.part_settings}
    is_projection_printed = servo.estimator == PAPER_PROJECTION_ESTIMATOR
    if options.estimator == "projection" and is_projection_printed:
        return type(options)(options.path, **groups)
    groups[options.USER_GROUPS.get(name, name)] = servo.estimator
    estimator = options.estimator if options.estimator == name else None
    return type(options)(options.path, estimator=estimator, **groups)


def _list_user_classes(options: ReplayOptions) -> dict[str, type[Estimator]]:
    """Return the classes of the user-defined estimators that the command line names."""
    return {name: type(estimator) for name, estimator in options.user_estimators.items()}


def _rebuild_servo(options: ReplayOptions, record: Record) -> Servo:
    """Return the servo of the first stage of a record."""
    if not record.stages:
        raise UnusableFile(options.path, "does not record the servo of its ticks")
    return rebuild_stage_servo(record, record.stages[0], _list_user_classes(options))


def _change_servo(options: ReplayOptions, record: Record) -> Servo:
    """Return the recorded servo with the settings of the command line."""
    servo = _rebuild_servo(options, record)
    estimator = options.estimator or find_class_name(servo.estimator, ESTIMATORS)
    return replace(servo, **options.collect_parts(estimator))


def _print_differences(console: Console, result: ReplayResult) -> None:
    """Print how the commanded speeds and phases change with the other settings."""
    replays = result.recorded, result.recomputed
    v_recorded, v_recomputed = (rows.ticks["v"] for rows in replays)
    table = Table("", "as recorded", "with these settings")
    medians = [np.median(np.linalg.norm(v, axis=1)) for v in (v_recorded, v_recomputed)]
    table.add_row("median commanded speed of marker 1", *(f"{speed:.2f} mm/s" for speed in medians))
    for name in dict.fromkeys((*result.recorded.phase, *result.recomputed.phase)):
        table.add_row(f"ticks in {name}", *(str(rows.phase.count(name)) for rows in replays))
    difference = np.median(np.linalg.norm(v_recorded - v_recomputed, axis=1))
    label = "median difference of the commanded velocities"
    table.add_row(label, "", f"{difference:.2f} mm/s")
    console.print(table)
