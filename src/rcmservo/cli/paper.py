"""`rcmservo paper`: all experiments of the paper, and one report that judges its claims."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from rcmservo.cli.progress.progress import print_resume_hint, show_progress
from rcmservo.cli.servo_options import EstimatorOptions, OptionalEstimator
from rcmservo.cli.terminal import open_console
from rcmservo.config.new_folder import make_dated_path
from rcmservo.config.rig_file import RigDescription
from rcmservo.config.user_estimators import hash_source
from rcmservo.errors import require, require_extra
from rcmservo.servo.user_estimator import check_estimator

if TYPE_CHECKING:
    from rcmservo.paper.claims import ClaimRow
    from rcmservo.paper.lab.methods import UserEstimatorMethod

EXIT_INCOMPLETE = 1
"""Exit code if the report leaves out an experiment that could not be measured."""

QUICK_REMARK = (
    "this is the quick set: one or two runs per case (n = 1 or 2) give a first impression and no "
    "verdict; the numbers differ from those of the full set"
)
VERDICTS = ("holds", "holds with a remark", "does not hold")
"""Possible verdicts on a claim of the paper."""


@dataclass(frozen=True)
class PaperOptions(EstimatorOptions):
    """Run all experiments of the paper in simulation and write one report that judges its claims.

    Parameters
    ----------
    out : Path or None
        Output folder: new or empty, or that of an earlier run, which then resumes. By default a
        new one under runs/.
    quick : bool
        Reduced set: few seeds, a camera that delivers points, one run on rendered frames. One
        or two runs per case give numbers but no verdict.
    only : str or None
        Name of the one experiment to run.
    estimator : OptionalEstimator
        Your own estimator, as module:class, to compare with the others in `baselines`.
    """

    out: Path | None = None
    quick: bool = False
    only: str | None = None
    estimator: OptionalEstimator = None


def paper(options: PaperOptions) -> int:
    """Run the remaining experiments and write the report; return 0 if the report is complete."""
    with require_extra("paper", "sim"):
        from rcmservo.paper import run, store

        experiments = run.select_experiments(options.only, _make_user_method(options))
    console = open_console()
    folder = options.out or make_dated_path("paper")
    tasks = [task for experiment in experiments.values() for task in experiment.plan(options.quick)]
    store.prepare(folder, options.quick)
    announcement = f"{len(tasks)} simulated tasks on all cores, into {folder}"
    console.print(announcement, style="dim", soft_wrap=True)
    total_cost = sum(task.cost for task in tasks)
    with (
        print_resume_hint(folder, console),
        show_progress(console, "simulating", total_cost) as advance,
    ):
        report = run.run(folder, options.quick, experiments, lambda task: advance(task.cost))
    build_table = _build_verdict_table if options.only is None else _build_claim_table
    console.print(build_table(report.rows))
    if options.quick:
        console.print(QUICK_REMARK, soft_wrap=True)
    for name, reason in report.left_out.items():
        console.print(f"{name} is left out: {reason}", soft_wrap=True)
    console.print(f"report in {report.page}", soft_wrap=True)
    return EXIT_INCOMPLETE if report.left_out else 0


def _make_user_method(options: PaperOptions) -> "UserEstimatorMethod | None":
    """Return the user-defined estimator of --estimator as a method, after a trial of its code."""
    from rcmservo.paper.lab.methods import UserEstimatorMethod

    name = options.estimator
    if name is None:
        return None
    expected = "your own estimator, as module:class"
    require(name in options.user_estimators, "--estimator", name, expected)
    estimator = options.user_estimators[name]
    check_estimator(estimator, RigDescription().tool)
    short_name = name.rpartition(":")[2]
    return UserEstimatorMethod(name, short_name, estimator, source=hash_source(estimator))


def _build_claim_table(rows: "list[ClaimRow]") -> Table:
    """Return the claims of one experiment; one or two trials give no verdict."""
    table = Table("claim", "where", "measured", "verdict")
    for row in rows:
        claim = ": ".join(filter(None, (row.claim, *row.case)))
        verdict = row.verdict or f"n = {row.trials}"
        interval = "({:.3g} to {:.3g}) ".format(*row.interval) if row.interval else ""
        table.add_row(claim, row.where, f"{row.measured:.3g} {interval}{row.unit}", verdict)
    return table


def _build_verdict_table(rows: "list[ClaimRow]") -> Table:
    """Return the number of claims with each verdict, by experiment."""
    table = Table("experiment", *VERDICTS, "no verdict")
    for name in dict.fromkeys(row.experiment for row in rows):
        verdicts = [row.verdict for row in rows if row.experiment == name]
        table.add_row(name, *(str(verdicts.count(verdict)) for verdict in (*VERDICTS, None)))
    return table
