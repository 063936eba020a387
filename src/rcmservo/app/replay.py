"""`rcmservo replay`: score a recording, or compute the decisions of a recorded run again."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from rcmservo.app.folders import new_folder
from rcmservo.app.parse import OptionalPath
from rcmservo.app.servo_options import Boxes, EstimatorName, ServoOptions
from rcmservo.app.tables import show_differences, show_replay
from rcmservo.config.rig_file import Lab, load_lab
from rcmservo.config.servo_json import rebuild
from rcmservo.errors import UnusableFile, require
from rcmservo.method.estimators.projection import PRINTED
from rcmservo.record.reader import Record
from rcmservo.record.recompute import recompute
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers

OTHERWISE = 1
"""Exit code of a replay in which a decision came out otherwise."""


@dataclass(frozen=True)
class ReplayOptions:
    """Put recorded frames and joints through tracking, features, imaged RCM and the estimators, and
    score them.

    Of a recorded run, compute every decision again instead, with its own settings but for those
    given here: are they the same, bit for bit, and if not, where do they differ?
    """

    path: Annotated[Path, tyro.conf.Positional]
    """Folder with frames/ and poses.csv, or a run's folder or .mcap file."""
    estimator: EstimatorName | None = None
    """Of a run: another estimator than the recorded one. Of a recording all are scored."""
    rig: OptionalPath = None
    """TOML file that describes the recorded arm: mechanism, tool and markers. By default the
    built-in one."""
    out: OptionalPath = None
    """Folder to write replay.json and centres.csv to, new or empty; by default nothing is
    written."""
    json: bool = False
    """Print one JSON object on stdout and nothing else."""
    boxes: Boxes = field(default_factory=ServoOptions)


def recorded(asked: ReplayOptions, then: Record) -> ReplayOptions:
    """The settings that a run was recorded with, as a command that asks for them.

    The recorded estimator takes the place of its class's settings, but not the printed one where
    the command names `projection`: that would be itself under another name.
    """
    if not then.stages:
        raise UnusableFile(asked.path, "does not tell the servo of its ticks")
    servo = rebuild(then.stages[0].servo)
    boxes = ServoOptions(servo.controller, servo.exploration, servo.imaged_rcm)
    estimator: dict[str, Any] = {servo.estimator.name: servo.estimator}
    other = asked.estimator == "projection" and servo.estimator == PRINTED
    return ReplayOptions(asked.path, boxes=boxes if other else replace(boxes, **estimator))


def recompute_run(command: ReplayOptions, recorded: ReplayOptions, then: Record) -> int:
    """The decisions of a recorded run once more; the exit code is 1 where they are others."""
    require(
        command.rig is None, "--rig", command.rig, "left out for a run: its record tells the rig"
    )
    require(command.out is None, "--out", command.out, "left out for a run: nothing is written")
    again = recompute(
        then, None if command == replace(recorded, json=command.json) else _other(command, then)
    )
    if command.json:
        print(
            json.dumps(
                {
                    "same": again.same,
                    "open_loop": again.open_loop,
                    "ticks": len(again.then.time),
                    "first": again.first,
                    "differs": again.differs,
                    "missing": again.then.missing,
                }
            )
        )
    else:
        print(f"{again.words}; {again.then.missing}" if again.then.missing else again.words)
        if again.open_loop and not again.same:
            show_differences(Console(), again)
    return 0 if again.same else OTHERWISE


def _other(command: ReplayOptions, then: Record) -> Servo:
    """The recorded servo with the settings that the command asks for."""
    servo = rebuild(then.stages[0].servo)
    chosen = command.boxes.estimators
    estimator = chosen[command.estimator or servo.estimator.name]
    return replace(
        servo,
        estimator=estimator,
        controller=command.boxes.controller,
        exploration=command.boxes.exploration,
        imaged_rcm=command.boxes.imaged_rcm,
    )


def replay(command: ReplayOptions) -> int:
    from rcmservo.offline import score

    if not command.path.exists():
        raise UnusableFile(command.path, "does not exist")
    require(
        command.estimator is None,
        "--estimator",
        command.estimator,
        "left out for a recording: all are scored",
    )
    lab = load_lab(command.rig) if command.rig else Lab()
    chosen = command.boxes.estimators
    console = Console(stderr=command.json)
    bar = Progress(
        TextColumn("tracking"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total} frames"),
        console=console,
        transient=True,
    )
    with bar:
        task = bar.add_task("tracking", total=None)
        result = score.replay(
            command.path,
            lab,
            ColourMarkers(lab.markers),
            chosen,
            command.boxes.imaged_rcm,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    report = _report(result)
    if command.out is not None:
        with new_folder(command.out, "replay") as folder:
            (folder / "replay.json").write_text(json.dumps(report, indent=2) + "\n")
            (folder / "centres.csv").write_text(_centres(report))
    if command.json:
        print(json.dumps(report))
    else:
        show_replay(console, report)
    return 0


def _report(result: Any) -> dict[str, Any]:
    """A replay as plain numbers; None where there is none."""
    return {
        "frames": [
            {"frame": pose.name, "m1": _pair(found.points[0]), "m2": _pair(found.points[1])}
            for pose, found in zip(result.poses, result.markers, strict=True)
        ],
        "imaged_rcm_px": _pair(result.o_c),
        "imaged_rcm_condition": _finite(result.condition),
        "reprojection_rms_px": {
            "m1": _finite(result.reprojection[0]),
            "m2": _finite(result.reprojection[1]),
        },
        "one_step_rms": {
            name: {"s_deg": _finite(np.degrees(s)), "r_px": _finite(r), "d_px": _finite(d)}
            for name, (s, r, d) in result.one_step.items()
        },
    }


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _pair(point: Any) -> list[float] | None:
    return [float(point[0]), float(point[1])] if np.isfinite(point).all() else None


def _centres(report: dict[str, Any]) -> str:
    lines = ["frame,m1_u_px,m1_v_px,m2_u_px,m2_v_px"]
    for row in report["frames"]:
        numbers = (*(row["m1"] or ("", "")), *(row["m2"] or ("", "")))
        lines.append(",".join([row["frame"], *(f"{n:.3f}" if n != "" else "" for n in numbers)]))
    return "\n".join(lines) + "\n"
