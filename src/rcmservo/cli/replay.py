"""`rcmservo replay`: score a recording, or recompute the decisions of a recorded run."""

import json
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from rcmservo.cli.folders import open_new_folder
from rcmservo.cli.score_report import convert_score_to_json, format_centres_csv, print_score
from rcmservo.cli.servo_options import OPTION_GROUPS, OptionalEstimator, ServoOptions
from rcmservo.cli.terminal import open_console
from rcmservo.config.atomic_files import write_atomically
from rcmservo.config.registry import ESTIMATORS, find_class_name
from rcmservo.config.rig_file import METHOD_PARTS, load_rig_file
from rcmservo.errors import UnusableFile, require
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR
from rcmservo.geometry.tool import Tool
from rcmservo.recording.foreign import scoring
from rcmservo.recording.reader import Record
from rcmservo.recording.replay import ReplayResult, rebuild_stage_servo, replay_record
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import check_estimator, guard_strictly
from rcmservo.tracking import ColourMarkers

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


def rebuild_recorded_options(options: ReplayOptions, record: Record) -> ReplayOptions:
    """Return the recorded settings of a run as options of this command.

    The recorded estimator replaces the settings of its class. The printed estimator does not where
    the command names `projection`, because the two names would then mean the same estimator.
    """
    if not record.stages:
        raise UnusableFile(options.path, "does not record the servo of its ticks")
    servo = rebuild_stage_servo(record, record.stages[0], user_estimator_classes(options))
    name = find_class_name(servo.estimator, ESTIMATORS)
    groups: dict[str, Any] = {
        part: getattr(servo, part) for part in METHOD_PARTS if part in OPTION_GROUPS
    }
    is_printed_variant = (
        options.estimator == "projection" and servo.estimator == PAPER_PROJECTION_ESTIMATOR
    )
    if not is_printed_variant:
        groups[options.USER_GROUPS.get(name, name)] = servo.estimator
    is_named = options.estimator == name and not is_printed_variant
    estimator = options.estimator if is_named else None
    return type(options)(options.path, estimator=estimator, **groups)


def user_estimator_classes(options: ReplayOptions) -> dict[str, type[Estimator]]:
    """Return the classes of the user-defined estimators that the command line names."""
    return {name: type(estimator) for name, estimator in options.user_estimators.items()}


def recompute_run(options: ReplayOptions, recorded: ReplayOptions, record: Record) -> int:
    """Recompute the decisions of a recorded run; return 1 if any of them differs."""
    expected = "left out for a run, whose record describes the rig"
    require(options.rig is None, "--rig", options.rig, expected)
    require(options.out is None, "--out", options.out, "left out for a run, which writes nothing")
    as_recorded = options == replace(recorded, json=options.json)
    changed = None if as_recorded else _changed_servo(options, record)
    result = replay_record(record, changed, user_estimator_classes(options))
    if options.json:
        print(json.dumps(result.numbers))
    else:
        print("; ".join(filter(None, (result.sentence, record.missing))))
        if result.open_loop and not result.same:
            _print_differences(open_console(), result)
    return 0 if result.same else EXIT_DECISIONS_DIFFER


def _changed_servo(options: ReplayOptions, record: Record) -> Servo:
    """Return the recorded servo with the settings of the command line."""
    servo = rebuild_stage_servo(record, record.stages[0], user_estimator_classes(options))
    parts = options.collect_parts(options.estimator or find_class_name(servo.estimator, ESTIMATORS))
    return replace(servo, **parts)


def _print_differences(console: Console, result: ReplayResult) -> None:
    """Print how the commanded speeds and phases change with the other settings."""
    recorded, recomputed = result.recorded, result.recomputed
    table = Table("", "as recorded", "with these settings")
    speeds = [np.median(np.linalg.norm(rows.ticks["v"], axis=1)) for rows in (recorded, recomputed)]
    table.add_row("median commanded speed of marker 1", *(f"{speed:.2f} mm/s" for speed in speeds))
    for name in dict.fromkeys((*recorded.phase, *recomputed.phase)):
        counts = [rows.phase.count(name) for rows in (recorded, recomputed)]
        table.add_row(f"ticks in {name}", *map(str, counts))
    difference = np.linalg.norm(recorded.ticks["v"] - recomputed.ticks["v"], axis=1)
    table.add_row(
        "median difference of the commanded velocities", "", f"{np.median(difference):.2f} mm/s"
    )
    console.print(table)


def replay(options: ReplayOptions) -> int:
    """Score a recording and return the exit code 0."""
    if not options.path.exists():
        raise UnusableFile(options.path, "does not exist")
    out = open_console(stderr=options.json)
    with nullcontext() if options.out is None else open_new_folder(options.out, "replay") as folder:
        scored = _score(options, out)
        if options.json:
            print(json.dumps(convert_score_to_json(scored)))
        else:
            print_score(out, scored)
        if folder is not None:
            write_atomically(
                folder / "replay.json", json.dumps(convert_score_to_json(scored), indent=2) + "\n"
            )
            write_atomically(folder / "centres.csv", format_centres_csv(scored))
    return 0


def _score(options: ReplayOptions, out: Console) -> scoring.RecordingScore:
    """Return the score of a recording; show a progress bar while its frames are tracked."""
    lab = load_rig_file(options.rig)
    estimators = _select_estimators(options, lab.tool)
    bar = Progress(
        TextColumn("tracking", markup=False),
        BarColumn(),
        TextColumn("{task.completed}/{task.total} frames", markup=False),
        console=out,
        transient=True,
    )
    with bar:
        task = bar.add_task("tracking", total=None)
        return scoring.score_recording(
            options.path,
            lab,
            ColourMarkers(lab.markers),
            estimators,
            options.part_settings["imaged_rcm"],
            lambda done, total: bar.update(task, completed=done, total=total),
        )


def _select_estimators(options: ReplayOptions, tool: Tool) -> dict[str, Estimator]:
    """Return the estimators to score: the built-in ones and the one that the options name."""
    name = options.estimator
    expected = "left out for a recording, where all built-in ones are scored, or module:class"
    require(name is None or name in options.user_estimators, "--estimator", name, expected)
    built_in = {
        key: one for key, one in options.estimators.items() if key not in options.user_estimators
    }
    if name is None:
        return built_in
    check_estimator(options.user_estimators[name], tool)
    return {**built_in, name: guard_strictly(options.user_estimators[name])}
