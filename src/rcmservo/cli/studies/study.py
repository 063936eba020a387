"""`rcmservo study`: compare methods in thousands of simulated scenes, with one report.

A method is an estimator with its settings. `WorkOptions` and the functions below `study` also serve
`rcmservo tune`.
"""

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

from rcmservo.cli.progress.compilation import report_compilation
from rcmservo.cli.progress.progress import print_resume_hint, show_progress
from rcmservo.cli.studies import study_report
from rcmservo.cli.terminal import open_console, open_status_line
from rcmservo.config.class_registry import ESTIMATORS, PRESETS
from rcmservo.config.new_folder import make_dated_path
from rcmservo.config.user_estimators import import_estimator
from rcmservo.constraints import Checked, between
from rcmservo.errors import require, require_extra
from rcmservo.estimation.base import Estimator
from rcmservo.study.plan.conditions import RunConditions

if TYPE_CHECKING:
    from rcmservo.study.execution.run_study import StudyExecution
    from rcmservo.study.execution.workers import WorkerPool
    from rcmservo.study.plan.file import StudyFile
    from rcmservo.study.plan.plan import StudyPlan

OptionalFile = Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[FILE]")]
Names = tyro.conf.UseAppendAction[tuple[str, ...]]


@dataclass(frozen=True, kw_only=True)
class WorkOptions(Checked):
    """Options of `study` and `tune`.

    Parameters
    ----------
    user_estimator : Names
        Your own estimator that FILE names, as module:class. User code runs only if the command
        line names it as well.
    out : Path or None
        Output folder, or that of an earlier study or search, which then resumes. By default a
        new one under runs/.
    workers : int or None
        Number of processes on this computer; by default one per processor.
    cluster : str or None
        Address of a dask scheduler whose workers run the study, such as tls://host:8786.
    """

    user_estimator: Names = ()
    out: Path | None = None
    workers: Annotated[int | None, between(1, 4096, "a whole number")] = None
    cluster: str | None = None


@dataclass(frozen=True, kw_only=True)
class StudyOptions(RunConditions, WorkOptions):
    """Compare methods in many simulated scenes.

    The output is one row per run, a report that compares the methods with confidence intervals, and
    a summary.

    Parameters
    ----------
    file : OptionalFile
        TOML file with methods, scenes and conditions. An option takes precedence over the file.
    method : Names
        Method to study: an estimator by name, or your own as module:class; repeatable. The
        others are compared with the first.
    scenes : Names
        Distribution of the scenes: random, paper, laparoscopic, hard, or a rig file;
        repeatable. --scenes help describes each.
    seed : int or None
        Seed of the first scene, by default 0; each further scene has the next seed.
    disturb : Names
        Disturbance in every run, as in `rcmservo run --disturb`.
    report : bool
        Write report.html as well.
    replay : int or None
        Only rerun and record one run of the study in --out, given by its row.
    video : bool
        Write a video of that run as well.
    """

    file: OptionalFile = None
    method: Names = ()
    scenes: Names = ()
    seed: int | None = None
    disturb: Names = ()
    report: bool = True
    replay: int | None = None
    video: bool = False

    @cached_property
    def study_file(self) -> "StudyFile":
        """Study that FILE describes, or the default study."""
        with require_extra("a study", "study"):
            from rcmservo.study.plan.distribution import BUILT_IN_DISTRIBUTIONS
            from rcmservo.study.plan.file import StudyFile, read_study_file
        if self.file is None:
            return StudyFile()
        if str(self.file) in (*ESTIMATORS, *PRESETS, *BUILT_IN_DISTRIBUTIONS):
            expected = "a TOML file; repeat --method or --scenes to give several names"
            require(self.file.exists(), "FILE", self.file, expected)
        return read_study_file(self.file)

    @property
    def file_defaults(self) -> "StudyOptions | None":
        """Options that FILE gives for those that the command line leaves out."""
        return None if self.file is None else StudyOptions(**_collect_conditions(self.study_file))


def study(options: StudyOptions) -> int:
    """Run the remaining runs and write rows and report; return the exit code 0."""
    with require_extra("a study", "study"):
        from rcmservo.cli.studies.rerun import rerun_row
        from rcmservo.study.execution.run_study import StudyExecution
        from rcmservo.study.plan import distribution
        from rcmservo.study.report import report
    console = open_console()
    if "help" in options.scenes:
        console.print(study_report.build_distribution_table(distribution.describe_built_in()))
        return 0
    if options.replay is not None:
        user_estimators = import_user_estimators(options)
        return rerun_row(options.out, options.replay, options.video, user_estimators)
    require(not options.video, "--video", True, "given with --replay")
    plan = make_plan(options)
    folder = options.out or make_dated_path("study")
    require_other_folder(options.file, folder)
    execution = StudyExecution(plan, folder)
    study_report.print_work(console, execution)
    with print_resume_hint(folder, console):
        speed = _run_remaining(execution, options, console) if execution.missing else {}
        header = make_report_header(execution) | speed
        written = report.write_report(folder, plan, execution.gather(), header, options.report)
    study_report.print_results(console, written.summaries, written.comparisons)
    files = "rows, summary and report" if options.report else "rows and summary"
    console.print(f"{files} in {folder}", soft_wrap=True)
    return 0


def _collect_conditions(source: RunConditions) -> dict[str, Any]:
    """Return the conditions that a file and the options share."""
    return {f.name: getattr(source, f.name) for f in fields(RunConditions)}


def make_plan(options: StudyOptions) -> "StudyPlan":
    """Return the plan of the file, in which the given options take precedence."""
    from rcmservo.sim.disturbances import Disturbance
    from rcmservo.study.plan.file import make_plan

    for text in options.disturb:
        Disturbance.parse(text)  # raises an error for an invalid one
    values = {
        "methods": options.method,
        "scenes": options.scenes,
        "first_seed": options.seed,
        "disturb": (options.disturb,) if options.disturb else (),
    }
    given = {name: value for name, value in values.items() if value not in ((), None)}
    study_file = replace(options.study_file, **_collect_conditions(options), **given)
    return make_plan(study_file, import_user_estimators(options))


def require_other_folder(file: Path | None, folder: Path) -> None:
    """Refuse a FILE that a search wrote in the output folder, where it would be removed."""
    from rcmservo.study.execution.store import TUNED_FILE

    is_other = file is None or file.resolve() != (folder / TUNED_FILE).resolve()
    expected = f"a folder other than that of FILE, where {TUNED_FILE} would be removed"
    require(is_other, "--out", folder, expected)


def import_user_estimators(options: StudyOptions) -> dict[str, type[Estimator]]:
    """Return the user-defined estimators that the command line names, and import their code."""
    methods = [name for name in options.method if ":" in name]
    imported = {name: import_estimator(name, "--method") for name in methods}
    for name in options.user_estimator:
        imported[name] = import_estimator(name, "--user-estimator")
    return imported


def _run_remaining(
    execution: "StudyExecution", options: StudyOptions, console: Console
) -> dict[str, object]:
    """Run the remaining runs; return the entries of a report on the workers and the speed."""
    run_count, missing_count = execution.plan.runs, execution.missing_runs
    with open_workers(execution, options, console) as workers:
        start_s, worker_count = time.monotonic(), workers.count
        done_count = run_count - missing_count
        with show_progress(console, "running", run_count, done_count, "runs") as advance:
            execution.run(workers, advance)
        pace = f"{missing_count} runs in {time.monotonic() - start_s:.1f} s"
    return {"workers": f"{worker_count} on {workers.where}", "pace": pace}


@contextmanager
def open_workers(
    execution: "StudyExecution", options: WorkOptions, console: Console
) -> Generator["WorkerPool"]:
    """Yield workers, after everything that the study needs is compiled."""
    from rcmservo.study.execution.workers import open_worker_pool, require_protected

    if options.cluster is not None:
        require_protected(options.cluster)
    with ExitStack() as stack:
        with open_status_line(console) as status_line:
            with report_compilation(status_line):
                execution.compile()
            status_line.update(Text("waiting for workers …", style="dim"))
            workers = stack.enter_context(open_worker_pool(options.cluster, options.workers))
        yield workers


def make_report_header(execution: "StudyExecution") -> dict[str, object]:
    """Return the entries of a report on its origin."""
    from rcmservo.study.execution.package_version import identify_package

    names = "".join(f" --user-estimator {name}" for name in execution.user_estimators)
    folder = shlex.quote(str(execution.store.folder))
    return {
        "command": " ".join(["rcmservo", *map(shlex.quote, sys.argv[1:])]),
        "replay": f"rcmservo study --out {folder}{names} --replay",
        "package": identify_package(),
        "made": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "runs": execution.plan.runs,
    }
