"""`rcmservo study`: methods over thousands of scenes, and one report that compares them."""

import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rcmservo.app.folders import dated
from rcmservo.app.parse import OptionalPath
from rcmservo.app.preparing import compiling
from rcmservo.app.progress import going_on, progress
from rcmservo.app.terminal import console
from rcmservo.config.own_code import named
from rcmservo.errors import RcmServoError, require

if TYPE_CHECKING:
    from rcmservo.study.plan.file import StudyFile
    from rcmservo.study.plan.plan import Plan
    from rcmservo.study.told.summary import Summary
    from rcmservo.study.work.go import Work

OptionalFile = Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
Names = tyro.conf.UseAppendAction[tuple[str, ...]]


@dataclass(frozen=True)
class StudyOptions:
    """Try methods in many simulated scenes, and write one row a run, a report that compares them
    with intervals, and a summary."""

    file: OptionalFile = None
    """TOML file with methods, scenes and conditions. What an option says goes before it."""
    method: Names = ()
    """What is tried: an estimator by its name, or your own as module:class; may be given several
    times. The first is what the others are held against."""
    scenes: Names = ()
    """What scenes are drawn from: random, paper, laparoscopic, hard, or a rig file; may be given
    several times. --scenes help says what each is."""
    own: Names = ()
    """Your own estimator, as module:class, that FILE names: code of others is run only where the
    command line names it too."""
    count: int | None = None
    """Scenes of each kind (200)."""
    seed: int | None = None
    """Of the first scene (0); the others follow one by one."""
    noise: tuple[float, ...] = ()
    """px of the camera that tells points; several are tried one after the other."""
    latency: tuple[float, ...] = ()
    """s from a frame's exposure to its arrival; several are tried one after the other."""
    disturb: Names = ()
    """What goes wrong in every run, as `rcmservo run --disturb` has it."""
    repetitions: int | None = None
    """Runs in each scene, with different noise (1)."""
    duration: float | None = None
    """Length of each run, s (15)."""
    shown: int | None = None
    """Frames that the target is shown for (300, 5 s)."""
    engine: str | None = None
    """auto, which is the compiled twin where it can do it, else MuJoCo; or compiled, mujoco, or
    pictures, which is MuJoCo with rendered frames."""
    out: OptionalPath = None
    """Folder to write to, or that of an earlier study, which then goes on where it stopped. By
    default a new one under runs/."""
    workers: int | None = None
    """Processes of this machine (one for each processor)."""
    cluster: str | None = None
    """Address of a dask scheduler whose workers are to do it, such as tls://host:8786."""
    report: bool = True
    """Write report.html too."""


def study(options: StudyOptions) -> int:
    """Do what is not done yet, and write rows and report."""
    with needed():
        from rcmservo.study.plan import distribution
        from rcmservo.study.work.go import Work
    if "help" in options.scenes:
        for name, about in distribution.described():
            print(f"{name:14}{about}")
        return 0
    plan, out = planned(options), console()
    folder = options.out or dated("study")
    work = Work(plan, folder)
    _tell(out, work, folder)
    began = time.monotonic()
    with going_on(folder, out):
        if work.left:
            _do(work, options, out)
        _write(work, options, out, folder)
    took = time.monotonic() - began
    out.print(f"rows in {folder}; {plan.runs} runs, {took:.0f} s", soft_wrap=True)
    return 0


@contextmanager
def needed() -> Generator[None]:
    """Import what studies need in here: where it is not installed, that is one sentence."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise RcmServoError(
            f"studies need more than is installed, {error.name} among it: pip install "
            "'rcmservo[study]'"
        ) from error


def planned(options: StudyOptions) -> "Plan":
    """The plan of a file, and of the options above it."""
    from rcmservo.study.plan.file import StudyFile, load, plan_of

    for value in (options.workers,):
        require(value is None or 1 <= value <= 4096, "--workers", value, "from 1 to 4096")
    own = {name: named(name, "--method") for name in options.method if ":" in name}
    own |= {name: named(name, "--own") for name in options.own}
    asked = load(options.file) if options.file is not None else StudyFile()
    return plan_of(_above(options, asked), own)


def _above(options: StudyOptions, asked: "StudyFile") -> "StudyFile":
    """What a file asks for, with what the options say put in its place."""
    said = {
        "methods": options.method,
        "scenes": options.scenes,
        "count": options.count,
        "first_seed": options.seed,
        "noise": options.noise,
        "latency": options.latency,
        "disturb": (options.disturb,) if options.disturb else (),
        "repetitions": options.repetitions,
        "duration": options.duration,
        "shown": options.shown,
        "engine": options.engine,
    }
    return replace(asked, **{k: value for k, value in said.items() if value not in ((), None)})


def _tell(out: Console, work: "Work", folder: Path) -> None:
    """What is going to be done."""
    plan, left = work.plan, work.runs_left
    words = f"{plan.runs} simulated runs into {folder}"
    if left < plan.runs:
        words += f"; {plan.runs - left} of them are there already"
    out.print(words, style="dim", soft_wrap=True)
    if work.changed:
        out.print(work.changed, soft_wrap=True)


def _do(work: "Work", options: StudyOptions, out: Console) -> None:
    """Have what is left done."""
    from rcmservo.study.work.crew import crew

    with Live(Text(""), console=out, refresh_per_second=8, transient=True) as line:
        with compiling(line):
            work.compile()
        line.update(Text("waiting for workers …", style="dim"))
        hands = crew(options.cluster, options.workers)
        workers = hands.__enter__()
    plan = work.plan
    try:
        before = plan.runs - work.runs_left
        with progress(out, "running", plan.runs, before, "runs") as advance:
            work.go(workers, advance)
    finally:
        hands.__exit__(*sys.exc_info())


def _write(work: "Work", options: StudyOptions, out: Console, folder: Path) -> None:
    """Rows, summary and report."""
    from rcmservo.study.told.summary import groups, summary_of

    table = work.gather()
    found = groups(work.plan, table)
    out.print(_results([summary_of(group) for group in found]))


def _results(rows: "list[Summary]") -> Table:
    """What the terminal shows of a study."""
    table = Table("method", "scenes", "engine", "success", "to 1 mm", "error", "/ bound", "stops")
    for row in rows:
        low, high = 100 * row.success.low, 100 * row.success.high
        table.add_row(
            row.method,
            row.condition,
            row.engine,
            f"{100 * row.success.value:.1f} % ({low:.1f}-{high:.1f})",
            f"{row.time_median_s.value:.2f} s",
            f"{row.pose_median_mm.value:.3f} mm",
            f"{row.ratio_rms.value:.2f}",
            ", ".join(f"{name} {count}" for name, count in row.stops.items()) or "–",
        )
    return table
