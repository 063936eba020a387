"""`rcmservo paper`: every experiment of the paper, and one report that judges its claims."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from rcmservo.cli.folders import dated_folder
from rcmservo.cli.progress.progress import progress, resume_hint
from rcmservo.cli.servo_options import EstimatorOptions, OptionalEstimator
from rcmservo.cli.terminal import console
from rcmservo.config.rig_file import Lab
from rcmservo.config.user_code import source
from rcmservo.errors import needing, require
from rcmservo.servo.user_estimator import examine

if TYPE_CHECKING:
    from rcmservo.paper.claims import ClaimRow
    from rcmservo.paper.lab.methods import Own

EXIT_INCOMPLETE = 1
"""Exit code of a report that leaves out what could not be measured."""

QUICK_REMARK = (
    "this was the quick set: one or two runs of a thing (n = 1 or 2) are a first look and no "
    "verdict; the numbers are its own, not those of the whole set"
)
VERDICTS = ("holds", "holds with a remark", "does not hold")


@dataclass(frozen=True)
class PaperOptions(EstimatorOptions):
    """Run every experiment of the paper in simulation, and write one report that judges its
    claims.

    Parameters
    ----------
    out : Path or None
        Folder to write to: new or empty, or that of an earlier run, which then goes on where it
        stopped. By default a new one under runs/.
    quick : bool
        A reduced set: few seeds, a camera that delivers points, one run on rendered frames. One or
        two runs of a thing give numbers, but no verdict.
    only : str or None
        One experiment by its name.
    estimator : OptionalEstimator
        A user's own estimator, as module:class, to stand beside the others in `baselines`.
    """

    out: Path | None = None
    quick: bool = False
    only: str | None = None
    estimator: OptionalEstimator = None


def paper(options: PaperOptions) -> int:
    """Run what is not done yet, and write the report; the exit code is 0 where nothing is missing
    in it.
    """
    with needing("paper", "sim"):
        from rcmservo.paper import run, store

        experiments = run.chosen(options.only, _user_method(options))
    out = console()
    folder = options.out or dated_folder("paper")
    tasks = [task for one in experiments.values() for task in one.plan(options.quick)]
    store.prepare(folder, options.quick)
    words = f"{len(tasks)} simulated pieces of work on all cores, into {folder}"
    out.print(words, style="dim", soft_wrap=True)
    total = sum(task.cost for task in tasks)
    with resume_hint(folder, out), progress(out, "simulating", total) as advance:
        written = run.run(folder, options.quick, experiments, lambda task: advance(task.cost))
    rows = written.rows
    out.print(_claim_table(rows) if options.only is not None else _verdict_table(rows))
    if options.quick:
        out.print(QUICK_REMARK, soft_wrap=True)
    for name, why in written.left_out.items():
        out.print(f"{name} is left out: {why}", soft_wrap=True)
    out.print(f"report in {written.page}", soft_wrap=True)
    return EXIT_INCOMPLETE if written.left_out else 0


def _user_method(options: PaperOptions) -> "Own | None":
    """The user's own estimator that the options name, as one of the methods; tried first."""
    from rcmservo.paper.lab.methods import Own

    name = options.estimator
    if name is None:
        return None
    require(name in options.user_estimators, "--estimator", name, "a user's own, as module:class")
    estimator = options.user_estimators[name]
    examine(estimator, Lab().tool)
    return Own(name, name.rpartition(":")[2], estimator, source=source(estimator))


def _claim_table(rows: "list[ClaimRow]") -> Table:
    """Every claim of one experiment; without a verdict where there are one or two trials."""
    table = Table("claim", "where", "measured", "verdict")
    for row in rows:
        claim = ": ".join(filter(None, (row.claim, *row.case)))
        verdict = row.verdict or f"n = {row.trials}"
        ends = "({:.3g} to {:.3g}) ".format(*row.interval) if row.interval else ""
        table.add_row(claim, row.where, f"{row.measured:.3g} {ends}{row.unit}", verdict)
    return table


def _verdict_table(rows: "list[ClaimRow]") -> Table:
    """How many claims of each experiment hold."""
    table = Table("experiment", *VERDICTS, "no verdict")
    for name in dict.fromkeys(row.experiment for row in rows):
        found = [row.verdict for row in rows if row.experiment == name]
        table.add_row(name, *(str(found.count(verdict)) for verdict in (*VERDICTS, None)))
    return table
