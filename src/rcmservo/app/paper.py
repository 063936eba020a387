"""`rcmservo paper`: every experiment of the paper, and one report that judges its claims."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from rcmservo.app.folders import dated
from rcmservo.app.parse import OptionalPath
from rcmservo.app.preparing import simulator
from rcmservo.app.terminal import console, is_alive

if TYPE_CHECKING:
    from rcmservo.experiments.harness.rows import Row

QUICK = (
    "this was the quick set: one or two runs of a thing (n = 1 or 2) are a first look and no "
    "verdict; the numbers are its own, not those of the whole set"
)
VERDICTS = ("holds", "holds with a remark", "does not hold")


@dataclass(frozen=True)
class PaperOptions:
    """Run every experiment of the paper in simulation, and write one report that judges its
    claims."""

    out: OptionalPath = None
    """Folder to write to: new or empty, or that of an earlier run, which then goes on where it
    stopped. By default a new one under runs/."""
    quick: bool = False
    """A reduced set: few seeds, a camera that delivers points, one run on rendered frames. One or
    two runs of a thing give numbers, but no verdict."""
    only: str | None = None
    """One experiment by its name."""


def paper(options: PaperOptions) -> int:
    """Run what is not done yet, and write the report."""
    with simulator("paper"):
        from rcmservo.experiments.harness import paper, report
    out = console()
    folder = options.out or dated("paper")
    tasks = paper.tasks_of(paper.chosen(options.only), options.quick)
    paper.prepare(folder, options.quick)
    count = sum(map(len, tasks.values()))
    words = f"{count} simulated pieces of work on all cores, into {folder}"
    out.print(words, style="dim", soft_wrap=True)
    total = sum(task.cost for some in tasks.values() for task in some)
    with _going_on(folder, out), _progress(out, total) as advance:
        page = paper.run(folder, options.quick, options.only, lambda task: advance(task.cost))
    rows = report.claims_in(folder)
    out.print(_claims(rows) if options.only is not None else _counts(rows))
    if options.quick:
        out.print(QUICK, soft_wrap=True)
    out.print(f"report in {page}", soft_wrap=True)
    return 0


@contextmanager
def _going_on(folder: Path, out: Console) -> Generator[None]:
    """After Ctrl-C, say how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        words = f"what is done is kept; the same command with --out {folder} goes on there"
        out.print(words, soft_wrap=True)
        raise


@contextmanager
def _progress(out: Console, total: float) -> Generator[Callable[[float], None]]:
    """How far the work is: a bar, or a line for every tenth where no bar can be seen."""
    columns = BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    words = TextColumn("simulating", markup=False)
    with Progress(words, *columns, console=out, transient=True) as bar:
        task = bar.add_task("", total=total)
        tenths = 0

        def advance(cost: float) -> None:
            nonlocal tenths
            bar.update(task, advance=cost)
            now = int(10.0 * bar.tasks[0].completed / total)
            if now > tenths and not is_alive(out):
                out.print(f"{10 * now} % of the work is done", soft_wrap=True)
            tenths = now

        yield advance


def _claims(rows: "list[Row]") -> Table:
    """Every claim of one experiment; without a verdict where there are one or two trials."""
    table = Table("claim", "where", "measured", "verdict")
    for row in rows:
        claim = ": ".join(filter(None, (row.claim, *row.case)))
        verdict = row.verdict or f"n = {row.trials}"
        table.add_row(claim, row.where, f"{row.measured:.3g} {row.unit}", verdict)
    return table


def _counts(rows: "list[Row]") -> Table:
    """How many claims of each experiment hold."""
    table = Table("experiment", *VERDICTS, "no verdict")
    for name in dict.fromkeys(row.experiment for row in rows):
        found = [row.verdict for row in rows if row.experiment == name]
        table.add_row(name, *(str(found.count(verdict)) for verdict in (*VERDICTS, None)))
    return table
