"""The command line: `rcmservo run`, `replay`, `show`, `export` and `paper`, over the settings
dataclasses."""

import contextlib
import io
import json
import os
import re
import sys
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text

from rcmservo.app.tables import (
    Story,
    show_claims,
    show_differences,
    show_live,
    show_replay,
    show_run,
)
from rcmservo.config.rig_file import Lab, load_lab, told_with
from rcmservo.config.servo_json import rebuild
from rcmservo.errors import RcmServoError, UnusableFile, require
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.flow import FlowEstimator
from rcmservo.method.estimators.projection import PRINTED, ProjectionEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.record import reader
from rcmservo.record.reader import Record, file_of
from rcmservo.record.recompute import recompute
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers

BAD_INPUT, INTERRUPTED, UNSETTLED = 2, 130, 1
EstimatorName = Literal["projection", "projection-printed", "flow", "broyden"]


@dataclass(frozen=True)
class Run:
    """Servo a simulated arm to a target that it was shown once, with a camera that nobody has
    calibrated."""

    seed: int = 0
    """Draws the camera, the start, the target and the noise."""
    duration: float = 30.0
    """Length of the run, s of simulated time."""
    estimator: EstimatorName = "projection"
    """How the Jacobian is learnt: projection is rule (21) with the fast Γ, projection-printed with
    the paper's Γ, flow is rule (28), broyden is the rank-1 update that III-C compares it to."""
    rig: Path | None = None
    """TOML file with your own mechanism, limits, tool, markers, camera, noise and scene."""
    out: Path | None = None
    """Folder to write to, new or empty; by default a new one under runs/."""
    video: bool = True
    """Write the overlay video."""
    frames: bool = False
    """Keep all frames in the record; `export` makes a recording of them."""
    disturb: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """What goes wrong, as kind:at=5,for=0.5,key=value; may be given several times. --disturb help
    lists all kinds."""
    target: Path | None = None
    """File with the target, as --save-target wrote it; by default the target is shown first."""
    save_target: Path | None = None
    """New file to keep the target in that was shown."""
    live: bool = False
    """In wall time: the simulated arm, its camera and the servo in processes of their own, and one
    that watches."""
    resumes: int = 0
    """How often a scripted person resumes after a pause, or shows the target again where that is
    needed."""
    json: bool = False
    """Print one JSON object on stdout and nothing else."""
    controller: SaturatedController = field(default_factory=SaturatedController)
    exploration: Exploration = field(default_factory=Exploration)
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    projection: ProjectionEstimator = field(default_factory=ProjectionEstimator)
    flow: FlowEstimator = field(default_factory=FlowEstimator)
    broyden: BroydenEstimator = field(default_factory=BroydenEstimator)


@dataclass(frozen=True)
class Replay:
    """Put recorded frames and joints through tracking, features, imaged RCM and the estimators, and
    score them.

    Of a recorded run, compute every decision again instead, with its own settings but for those
    given here: are they the same, bit for bit, and if not, where do they differ?
    """

    path: Annotated[Path, tyro.conf.Positional]
    """Folder with frames/ and poses.csv, or a run's folder or .mcap file."""
    estimator: EstimatorName | None = None
    """Of a run: another estimator than the recorded one. Of a recording all are scored."""
    rig: Path | None = None
    """TOML file that describes the recorded arm: mechanism, tool and markers. By default the
    built-in one."""
    out: Path | None = None
    """Folder to write replay.json and centres.csv to, new or empty; by default nothing is
    written."""
    json: bool = False
    """Print one JSON object on stdout and nothing else."""
    controller: SaturatedController = field(default_factory=SaturatedController)
    exploration: Exploration = field(default_factory=Exploration)
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    projection: ProjectionEstimator = field(default_factory=ProjectionEstimator)
    flow: FlowEstimator = field(default_factory=FlowEstimator)
    broyden: BroydenEstimator = field(default_factory=BroydenEstimator)


@dataclass(frozen=True)
class Show:
    """Tell what happened in a recorded run: a summary, a timeline of phases and causes, and
    figures."""

    record: Annotated[Path, tyro.conf.Positional]
    """A run's folder, or an .mcap file."""
    out: Path | None = None
    """Folder to write the figures to, new or empty; by default a new one under runs/."""


@dataclass(frozen=True)
class Export:
    """Write a recorded run as CSV and NumPy arrays and, if it holds frames, as a recording that
    `replay` reads."""

    record: Annotated[Path, tyro.conf.Positional]
    """A run's folder, or an .mcap file."""
    out: Path | None = None
    """Folder to write to, new or empty; by default a new one under runs/."""


@dataclass(frozen=True)
class Paper:
    """Run every experiment of the paper in simulation, and write one report that judges its
    claims."""

    out: Path | None = None
    """Folder to write to: new or empty, or that of an earlier run, which then goes on where it
    stopped. By default a new one under runs/."""
    quick: bool = False
    """A reduced set: few seeds, a camera that delivers points, one run on rendered frames."""
    only: str | None = None
    """One experiment by its name."""


Command = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Paper, tyro.conf.subcommand("paper")]
)


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the exit code is 0, 1 where a run did not settle, 2 for bad input, 130 for
    Ctrl-C."""
    try:
        command = _parse(arguments)
        if isinstance(command, Replay) and file_of(command.path).is_file():
            then = reader.read(command.path)
            recorded = _recorded(command, then)
            return _recompute(_parse(arguments, recorded), recorded, then)
        acts: dict[type[Any], Callable[[Any], int]] = {
            Run: _run,
            Replay: _replay,
            Show: _show,
            Export: _export,
            Paper: _paper,
        }
        return acts[type(command)](command)
    except RcmServoError as error:
        return _fail(str(error))
    except OSError as error:
        return _fail(f"{error.filename or 'output'}: cannot be used: {error.strerror}")
    except KeyboardInterrupt:
        print("rcmservo: stopped by Ctrl-C", file=sys.stderr)
        return INTERRUPTED


class Unparsed(RcmServoError):
    """A command line that does not say what to do."""


def _parse(arguments: list[str] | None, default: Any = tyro.MISSING) -> Any:
    """The command line as settings. What is wrong with it comes as one sentence instead of tyro's
    boxes."""
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            kind: Any = Command
            return tyro.cli(kind, prog="rcmservo", args=arguments, default=default)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise Unparsed(_sentence(errors.getvalue())) from None


def _sentence(box: str) -> str:
    """The first part of a boxed error, without its title, and the option that was probably
    meant."""
    parts: list[list[str]] = [[]]
    for line in (line.strip("│╰╯ ") for line in box.splitlines()[1:]):
        if line.strip("─-"):
            parts[-1].append(line)
        elif line and parts[-1]:
            parts.append([])
    words = re.sub(r"Error parsing \S*__tyro\S+: ", "", " ".join(parts[0])).rstrip(".")
    near = next(
        (part[1].split()[0] for part in parts if part and part[0].startswith("Perhaps you meant")),
        None,
    )
    hint = f" (did you mean {near}?)" if near else ""
    return f"{words[:1].lower()}{words[1:]}{hint}; see rcmservo --help"


def _fail(sentence: str) -> int:
    print(f"rcmservo: {sentence}", file=sys.stderr)
    return BAD_INPUT


def estimators(
    projection: ProjectionEstimator, flow: FlowEstimator, broyden: BroydenEstimator
) -> dict[str, Estimator]:
    """The estimators by the names that the command line and the results use."""
    return {
        "projection": projection,
        "projection-printed": PRINTED,
        "flow": flow,
        "broyden": broyden,
    }


def _run(command: Run) -> int:
    require(command.seed >= 0, "--seed", command.seed, "a whole number that is not negative")
    require(
        1.0 < command.duration <= 3600.0,
        "--duration",
        command.duration,
        "more than 1 and at most 3600 s",
    )
    require(
        0 <= command.resumes <= 1000, "--resumes", command.resumes, "a whole number from 0 to 1000"
    )
    lab = load_lab(command.rig) if command.rig else Lab()
    with _simulator("run"):
        from rcmservo.app.simulated_run.simulate import Job, rig_settings, simulate
        from rcmservo.sim.disturb import Disturbance, describe
    if "help" in command.disturb:
        print(describe())
        return 0
    if command.rig is not None:
        with told_with(command.rig):
            rig_settings(lab)  # reads the sections that only a simulation needs
    disturbances = tuple(Disturbance.parse(text) for text in command.disturb)
    shown = command.target is None or command.save_target is None
    require(
        shown,
        "--save-target",
        command.save_target,
        "left out with --target: no target is shown then",
    )
    if command.save_target is not None and command.save_target.exists():
        raise UnusableFile(
            command.save_target, "is there already, and nothing is overwritten: name a new file"
        )
    servo = Servo(
        mechanism=lab.mechanism,
        tool=lab.tool,
        estimator=estimators(command.projection, command.flow, command.broyden)[command.estimator],
        controller=command.controller,
        exploration=command.exploration,
        imaged_rcm=command.imaged_rcm,
        gate=lab.gate,
        thresholds=lab.thresholds,
    )
    console = Console(stderr=command.json)
    with _new_folder(command.out, f"run-seed{command.seed}") as folder:
        job = Job(
            command.seed,
            command.duration,
            command.estimator,
            servo,
            lab,
            folder,
            command.video,
            command.frames,
            disturbances,
            command.resumes,
            command.target,
            command.save_target,
        )
        console.print(f"[dim]simulated arm and camera, seed {command.seed}; preparing …[/dim]")
        with Live(Text(""), console=console, refresh_per_second=8, transient=True) as live:
            metrics = (
                _run_live(command, job, live)
                if command.live
                else simulate(job, Story(live, command.duration))
            )
    if command.json:
        print(json.dumps(metrics))
    else:
        (show_live if command.live else show_run)(console, metrics)
    return 0 if metrics["settled"] else UNSETTLED


def _run_live(command: Run, job: Any, live: Live) -> dict[str, Any]:
    """A run in wall time; its metrics."""
    from rcmservo.app.simulated_run.simulate import about, keep, rig_settings
    from rcmservo.live.servo_process import Report, Task
    from rcmservo.live.supervisor import run_live

    for name in ("disturb", "frames", "target", "save_target", "resumes"):
        require(
            not getattr(command, name),
            f"--{name.replace('_', '-')}",
            getattr(command, name),
            "left out with --live",
        )
    said = [""]

    def progress(report: Report) -> None:
        if report.words != said[0]:
            said[0] = report.words
            live.console.print(
                f"{report.time * 1e-9:6.2f} s  {report.words}", soft_wrap=True, highlight=False
            )
        live.update(
            Text(f"{report.time * 1e-9:6.2f} / {job.duration:g} s  {report.words}"), refresh=False
        )

    settings = rig_settings(job.lab)
    task = Task(
        job.servo, job.lab.markers, job.duration, job.folder / reader.RECORD, about(job, settings)
    )
    metrics = {"seed": job.seed, "estimator": job.name, "folder": str(job.folder)}
    return keep(job, metrics | run_live(job.seed, settings, task, progress))


@contextlib.contextmanager
def _simulator(command: str) -> Generator[None]:
    """Import what simulates in here: where it is not installed, that is one sentence."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise RcmServoError(
            f"{command} needs the simulator, and {error.name} is not installed: pip install "
            f"'rcmservo[sim]'"
        ) from error


def _paper(command: Paper) -> int:
    with _simulator("paper"):
        from rcmservo.experiments.harness import paper, report
    console = Console()
    folder = command.out or _dated("paper")
    tasks = paper.tasks_of(paper.chosen(command.only), command.quick)
    paper.prepare(folder, command.quick)
    count = sum(map(len, tasks.values()))
    total = sum(task.cost for some in tasks.values() for task in some)
    console.print(
        f"[dim]{count} simulated pieces of work on all cores, into {folder}[/dim]", soft_wrap=True
    )
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        shown = bar.add_task("simulating", total=total)
        try:
            page = paper.run(
                folder,
                command.quick,
                command.only,
                lambda task: bar.update(shown, advance=task.cost),
            )
        except KeyboardInterrupt:
            console.print(
                f"what is done is kept; the same command with --out {folder} goes on there",
                soft_wrap=True,
            )
            raise
    show_claims(
        console, json.loads((folder / report.CLAIMS).read_text()), every=command.only is not None
    )
    console.print(f"report in {page}", soft_wrap=True)
    return 0


def _show(command: Show) -> int:
    from rcmservo.app import show

    rows = reader.read(command.record)
    console = Console()
    with _new_folder(command.out, "show") as folder:
        show.draw(rows, folder)
    show.show(console, rows)
    drawn = any(folder.glob("*.png"))
    words = (
        f"figures and timeline.csv in {folder}"
        if drawn
        else f"timeline.csv in {folder}; there was nothing to draw"
    )
    console.print(words, soft_wrap=True)
    return 0


def _export(command: Export) -> int:
    from rcmservo.app.export import export

    console = Console()
    with _new_folder(command.out, "export") as folder:
        written = export(command.record, folder)
    what = f"{written.ticks} ticks" + (f" and {written.frames} frames" if written.frames else "")
    left = (
        f"; left out, as no tick tells their joints: {written.left_out}" if written.left_out else ""
    )
    missing = f"; {written.missing}" if written.missing else ""
    console.print(f"{what} written to {folder}{left}{missing}", soft_wrap=True)
    return 0


def _recorded(asked: Replay, then: Record) -> Replay:
    """The settings that a run was recorded with, as a command that asks for them.

    The recorded estimator takes the place of its class's settings, but not the printed one where
    the command names `projection`: that would be itself under another name.
    """
    if not then.stages:
        raise UnusableFile(asked.path, "does not tell the servo of its ticks")
    servo = rebuild(then.stages[0].servo)
    recorded = Replay(
        asked.path,
        controller=servo.controller,
        exploration=servo.exploration,
        imaged_rcm=servo.imaged_rcm,
    )
    estimator: dict[str, Any] = {servo.estimator.name: servo.estimator}
    other = asked.estimator == "projection" and servo.estimator == PRINTED
    return recorded if other else replace(recorded, **estimator)


def _recompute(command: Replay, recorded: Replay, then: Record) -> int:
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
    return 0 if again.same else UNSETTLED


def _other(command: Replay, then: Record) -> Servo:
    """The recorded servo with the settings that the command asks for."""
    servo = rebuild(then.stages[0].servo)
    chosen = estimators(command.projection, command.flow, command.broyden)
    estimator = chosen[command.estimator or servo.estimator.name]
    return replace(
        servo,
        estimator=estimator,
        controller=command.controller,
        exploration=command.exploration,
        imaged_rcm=command.imaged_rcm,
    )


def _replay(command: Replay) -> int:
    from rcmservo.offline.score import replay

    if not command.path.exists():
        raise UnusableFile(command.path, "does not exist")
    require(
        command.estimator is None,
        "--estimator",
        command.estimator,
        "left out for a recording: all are scored",
    )
    lab = load_lab(command.rig) if command.rig else Lab()
    chosen = estimators(command.projection, command.flow, command.broyden)
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
        result = replay(
            command.path,
            lab,
            ColourMarkers(lab.markers),
            chosen,
            command.imaged_rcm,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    report = _report(result)
    if command.out is not None:
        with _new_folder(command.out, "replay") as folder:
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


def _dated(name: str) -> Path:
    """A folder under runs/ that nobody has used yet."""
    return Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}"


@contextlib.contextmanager
def _new_folder(out: Path | None, name: str) -> Generator[Path]:
    """The folder to write to: the user's, which must be new or empty, or a fresh one under runs/.

    Where nothing came to be written, all folders that were made for it go again.
    """
    folder = out or _dated(name)
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        _make_empty(folder)
        yield folder
    finally:
        for path in made:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def _make_empty(folder: Path) -> None:
    """Make the folder if it is not there, and refuse one that is in use or cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        full = any(folder.iterdir())
    except OSError as error:
        raise UnusableFile(folder, f"cannot be written to: {error.strerror}") from error
    if full:
        raise UnusableFile(folder, "is not empty, and nothing is overwritten: name a new folder")
    if not os.access(folder, os.W_OK):
        raise UnusableFile(folder, "cannot be written to")
