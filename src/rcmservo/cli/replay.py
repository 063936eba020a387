"""`rcmservo replay`: score a recording, or compute the decisions of a recorded run again."""

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

from rcmservo.cli.folders import new_folder
from rcmservo.cli.score_report import centres_csv, print_score, score_as_json
from rcmservo.cli.servo_options import OPTION_GROUPS, OptionalEstimator, ServoOptions
from rcmservo.cli.terminal import console
from rcmservo.config.atomic_files import write_whole
from rcmservo.config.registry import ESTIMATORS, name_of
from rcmservo.config.rig_file import METHOD_PARTS, load_lab
from rcmservo.errors import UnusableFile, require
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.projection_rule import PRINTED
from rcmservo.geometry.tool import Tool
from rcmservo.recording.foreign import scoring
from rcmservo.recording.reader import Record
from rcmservo.recording.replay import ReplayResult, rebuild_servo, replay_record
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import examine, strict
from rcmservo.tracking import ColourMarkers

EXIT_DECISIONS_DIFFER = 1
"""Exit code of a replay in which a decision came out otherwise."""


@dataclass(frozen=True)
class ReplayOptions(ServoOptions):
    """Put recorded frames and joints through tracking, features, imaged RCM and the estimators, and
    score them.

    Of a recorded run, compute every decision again instead, with its own settings but for those
    given here: are they the same, bit for bit, and if not, where do they differ?

    Parameters
    ----------
    path : Path
        Folder with frames/ and poses.csv, or a run's folder or .mcap file.
    estimator : OptionalEstimator
        Of a run: another estimator than the recorded one. Of a recording all are scored.
    rig : Path or None
        TOML file that describes the recorded arm: mechanism, tool and markers. By default the
        built-in one.
    out : Path or None
        Folder to write replay.json and centres.csv to, new or empty; by default nothing is written.
    json : bool
        Print one JSON object on stdout and nothing else.
    """

    path: Annotated[Path, tyro.conf.Positional]
    estimator: OptionalEstimator = None
    rig: Path | None = None
    out: Path | None = None
    json: bool = False


def recorded_options(options: ReplayOptions, record: Record) -> ReplayOptions:
    """The settings that a run was recorded with, as a command that asks for them.

    The recorded estimator takes the place of its class's settings, but not the printed one where
    the command names `projection`: that would be itself under another name.
    """
    if not record.stages:
        raise UnusableFile(options.path, "does not tell the servo of its ticks")
    servo = rebuild_servo(record, record.stages[0], user_estimator_classes(options))
    name = name_of(servo.estimator, ESTIMATORS)
    groups: dict[str, Any] = {
        part: getattr(servo, part) for part in METHOD_PARTS if part in OPTION_GROUPS
    }
    other = options.estimator == "projection" and servo.estimator == PRINTED
    if not other:
        groups[options.USER_GROUPS.get(name, name)] = servo.estimator
    own = options.estimator if options.estimator == name and not other else None
    return type(options)(options.path, estimator=own, **groups)


def user_estimator_classes(options: ReplayOptions) -> dict[str, type[Estimator]]:
    """The classes of the user's own estimators that the command line names."""
    return {name: type(estimator) for name, estimator in options.user_estimators.items()}


def recompute_run(options: ReplayOptions, recorded: ReplayOptions, record: Record) -> int:
    """The decisions of a recorded run once more; the exit code is 1 where they are others."""
    right = "left out for a run: its record tells the rig"
    require(options.rig is None, "--rig", options.rig, right)
    require(options.out is None, "--out", options.out, "left out for a run: nothing is written")
    as_recorded = options == replace(recorded, json=options.json)
    other = None if as_recorded else _changed_servo(options, record)
    again = replay_record(record, other, user_estimator_classes(options))
    if options.json:
        print(json.dumps(again.numbers))
    else:
        print("; ".join(filter(None, (again.sentence, record.missing))))
        if again.open_loop and not again.same:
            _print_differences(console(), again)
    return 0 if again.same else EXIT_DECISIONS_DIFFER


def _changed_servo(options: ReplayOptions, record: Record) -> Servo:
    """The recorded servo with the settings that the command asks for."""
    servo = rebuild_servo(record, record.stages[0], user_estimator_classes(options))
    parts = options.parts(options.estimator or name_of(servo.estimator, ESTIMATORS))
    return replace(servo, **parts)


def _print_differences(console: Console, again: ReplayResult) -> None:
    """What the other settings would have made of what was seen."""
    then, now = again.recorded, again.recomputed
    table = Table("", "as recorded", "with these settings")
    speeds = [np.median(np.linalg.norm(rows.ticks["v"], axis=1)) for rows in (then, now)]
    table.add_row("wanted speed of marker 1, median", *(f"{speed:.2f} mm/s" for speed in speeds))
    for name in dict.fromkeys((*then.phase, *now.phase)):
        counts = [rows.phase.count(name) for rows in (then, now)]
        table.add_row(f"ticks in {name}", *map(str, counts))
    apart = np.linalg.norm(then.ticks["v"] - now.ticks["v"], axis=1)
    table.add_row("the wanted velocities differ by, median", "", f"{np.median(apart):.2f} mm/s")
    console.print(table)


def replay(options: ReplayOptions) -> int:
    """Score a recording."""
    if not options.path.exists():
        raise UnusableFile(options.path, "does not exist")
    out = console(stderr=options.json)
    with nullcontext() if options.out is None else new_folder(options.out, "replay") as folder:
        scored = _score(options, out)
        if options.json:
            print(json.dumps(score_as_json(scored)))
        else:
            print_score(out, scored)
        if folder is not None:
            write_whole(folder / "replay.json", json.dumps(score_as_json(scored), indent=2) + "\n")
            write_whole(folder / "centres.csv", centres_csv(scored))
    return 0


def _score(options: ReplayOptions, out: Console) -> scoring.RecordingScore:
    """The score of a recording, with a bar while its frames are tracked."""
    lab = load_lab(options.rig)
    estimators = _estimators(options, lab.tool)
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
            options.settings["imaged_rcm"],
            lambda done, total: bar.update(task, completed=done, total=total),
        )


def _estimators(options: ReplayOptions, tool: Tool) -> dict[str, Estimator]:
    """The estimators to score: all of ours, and the user's own that the command names."""
    own = options.estimator
    right = "left out for a recording, where all of ours are scored, or module:class"
    require(own is None or own in options.user_estimators, "--estimator", own, right)
    ours = {
        name: one for name, one in options.estimators.items() if name not in options.user_estimators
    }
    if own is None:
        return ours
    examine(options.user_estimators[own], tool)
    return {**ours, own: strict(options.user_estimators[own])}
