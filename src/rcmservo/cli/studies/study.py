"""`rcmservo study`: methods over thousands of scenes, and one report that compares them."""

import shlex
import sys
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.text import Text

from rcmservo.cli.folders import dated_folder
from rcmservo.cli.progress.preparing import compiling
from rcmservo.cli.progress.progress import progress, resume_hint
from rcmservo.cli.studies.study_report import beside, distribution_table, print_work, results
from rcmservo.cli.terminal import console, status_line
from rcmservo.config.registry import ESTIMATORS, PRESETS
from rcmservo.config.user_code import named
from rcmservo.constraints import Checked, between
from rcmservo.errors import needing, require
from rcmservo.estimation.base import Estimator
from rcmservo.study.plan.conditions import RunConditions

if TYPE_CHECKING:
    from rcmservo.study.execution.run_study import Work
    from rcmservo.study.execution.workers import Crew
    from rcmservo.study.plan.file import StudyFile
    from rcmservo.study.plan.plan import StudyPlan

OptionalFile = Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[FILE]")]
Names = tyro.conf.UseAppendAction[tuple[str, ...]]


@dataclass(frozen=True, kw_only=True)
class WorkOptions(Checked):
    """Options of `study` and `tune`.

    Parameters
    ----------
    own : Names
        Your own estimator, as module:class, that FILE names: code of others is run only where the
        command line names it too.
    out : Path or None
        Folder to write to, or that of an earlier study or search, which then goes on where it
        stopped. By default a new one under runs/.
    workers : int or None
        Processes of this machine (one for each processor).
    cluster : str or None
        Address of a dask scheduler whose workers are to do it, such as tls://host:8786.
    """

    own: Names = ()
    out: Path | None = None
    workers: Annotated[int | None, between(1, 4096, "a whole number")] = None
    cluster: str | None = None


@dataclass(frozen=True, kw_only=True)
class StudyOptions(RunConditions, WorkOptions):
    """Try methods in many simulated scenes, and write one row a run, a report that compares them
    with intervals, and a summary.

    Parameters
    ----------
    file : OptionalFile
        TOML file with methods, scenes and conditions. What an option says goes before it.
    method : Names
        What is tried: an estimator by its name, or your own as module:class; may be given several
        times. The first is what the others are held against.
    scenes : Names
        What scenes are drawn from: random, paper, laparoscopic, hard, or a rig file; may be given
        several times. --scenes help says what each is.
    seed : int or None
        Of the first scene (0); the others follow one by one.
    disturb : Names
        What goes wrong in every run, as `rcmservo run --disturb` has it.
    report : bool
        Write report.html too.
    replay : int or None
        Instead of all this make one run of the study in --out again, by its row, and record it.
    film : bool
        Make a film of it too.
    """

    file: OptionalFile = None
    method: Names = ()
    scenes: Names = ()
    seed: int | None = None
    disturb: Names = ()
    report: bool = True
    replay: int | None = None
    film: bool = False

    @cached_property
    def study_file(self) -> "StudyFile":
        """The study in FILE; the usual one without."""
        with needing("a study", "study"):
            from rcmservo.study.plan.distribution import BUILT_IN
            from rcmservo.study.plan.file import StudyFile, load
        if self.file is None:
            return StudyFile()
        if str(self.file) in (*ESTIMATORS, *PRESETS, *BUILT_IN):
            right = "a TOML file; --method and --scenes take one name each, and may be given "
            require(self.file.exists(), "FILE", self.file, f"{right}several times")
        return load(self.file)

    @property
    def file_defaults(self) -> "StudyOptions | None":
        """Options that FILE gives where the command line does not."""
        return None if self.file is None else StudyOptions(**_conditions(self.study_file))


def study(options: StudyOptions) -> int:
    """Do what is not done yet, and write rows and report."""
    with needing("a study", "study"):
        from rcmservo.cli.studies.rerun import rerun_row
        from rcmservo.study.execution.run_study import Work
        from rcmservo.study.plan import distribution
        from rcmservo.study.report import report
    out = console()
    if "help" in options.scenes:
        out.print(distribution_table(distribution.described()))
        return 0
    if options.replay is not None:
        return rerun_row(options.out, options.replay, options.film, user_estimators(options))
    require(not options.film, "--film", True, "given with --replay")
    plan = make_plan(options)
    folder = options.out or dated_folder("study")
    require_other_folder(options.file, folder)
    work = Work(plan, folder)
    print_work(out, work)
    with resume_hint(folder, out):
        how = _run_remaining(work, options, out) if work.left else {}
        told = report.write(
            folder, plan, work.gather(), {**report_header(work), **how}, options.report
        )
    out.print(results(told.summaries))
    for one in told.comparisons:
        out.print(beside(one), soft_wrap=True)
    written = "rows, summary and report" if options.report else "rows and summary"
    out.print(f"{written} in {folder}", soft_wrap=True)
    return 0


def _conditions(given: RunConditions) -> dict[str, Any]:
    """Return the conditions that a file and the options share."""
    return {f.name: getattr(given, f.name) for f in fields(RunConditions)}


def make_plan(options: StudyOptions) -> "StudyPlan":
    """Return the plan of a file, with what the options say put in its place."""
    from rcmservo.sim.disturbances import Disturbance
    from rcmservo.study.plan.file import plan_of

    for text in options.disturb:
        Disturbance.parse(text)
    said = {
        "methods": options.method,
        "scenes": options.scenes,
        "first_seed": options.seed,
        "disturb": (options.disturb,) if options.disturb else (),
    }
    given = {name: value for name, value in said.items() if value not in ((), None)}
    asked = replace(options.study_file, **_conditions(options), **given)
    return plan_of(asked, user_estimators(options))


def require_other_folder(file: Path | None, folder: Path) -> None:
    """Refuse the FILE that a search has left in this very folder: it would go with the others."""
    from rcmservo.study.execution.store import TUNED

    kept = file is None or file.resolve() != (folder / TUNED).resolve()
    require(kept, "--out", folder, f"another folder than that of FILE, whose {TUNED} would go")


def user_estimators(options: StudyOptions) -> dict[str, type[Estimator]]:
    """The users' own estimators that the command line names; their code is run here first."""
    own = {name: named(name, "--method") for name in options.method if ":" in name}
    return own | {name: named(name, "--own") for name in options.own}


def _run_remaining(work: "Work", options: StudyOptions, out: Console) -> dict[str, object]:
    """Have what is left done; how that went."""
    runs, left = work.plan.runs, work.runs_left
    with workers_for(work, options, out) as hands:
        began, count = time.monotonic(), hands.count
        with progress(out, "running", runs, runs - left, "runs") as advance:
            work.go(hands, advance)
        took = time.monotonic() - began
    return {"workers": f"{count} on {hands.where}", "pace": f"{left} runs in {took:.1f} s"}


@contextmanager
def workers_for(work: "Work", options: WorkOptions, out: Console) -> Generator["Crew"]:
    """Workers, after all that the work needs was compiled."""
    from rcmservo.study.execution.workers import crew, require_guarded

    if options.cluster is not None:
        require_guarded(options.cluster)
    with ExitStack() as stack:
        with status_line(out) as line:
            with compiling(line):
                work.compile()
            line.update(Text("waiting for workers …", style="dim"))
            hands = stack.enter_context(crew(options.cluster, options.workers))
        yield hands


def report_header(work: "Work") -> dict[str, object]:
    """What a report says of its making."""
    from rcmservo.study.execution.package_version import package

    own = "".join(f" --own {name}" for name in work.own)
    folder = work.store.folder
    return {
        "command": " ".join(["rcmservo", *map(shlex.quote, sys.argv[1:])]),
        "replay": f"rcmservo study --out {shlex.quote(str(folder))}{own} --replay",
        "package": package(),
        "made": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "runs": work.plan.runs,
    }
