"""`rcmservo paper`: every experiment of the paper, and one report that judges its claims."""

import json
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rcmservo.app.folders import dated
from rcmservo.app.parse import OptionalPath
from rcmservo.app.simulator import simulator
from rcmservo.app.tables import show_claims


@dataclass(frozen=True)
class PaperOptions:
    """Run every experiment of the paper in simulation, and write one report that judges its
    claims."""

    out: OptionalPath = None
    """Folder to write to: new or empty, or that of an earlier run, which then goes on where it
    stopped. By default a new one under runs/."""
    quick: bool = False
    """A reduced set: few seeds, a camera that delivers points, one run on rendered frames."""
    only: str | None = None
    """One experiment by its name."""


def paper(command: PaperOptions) -> int:
    with simulator("paper"):
        from rcmservo.experiments.harness import paper, report
    console = Console()
    folder = command.out or dated("paper")
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
