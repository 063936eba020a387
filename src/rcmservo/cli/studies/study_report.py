"""Tables and sentences that `rcmservo study` and `tune` print on the terminal."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from rcmservo.study.report.text import build_result_table, describe_comparison

if TYPE_CHECKING:
    from rcmservo.study.execution.run_study import StudyExecution
    from rcmservo.study.report.summary import PairedComparison, Summary


def build_distribution_table(distributions: Iterable[tuple[str, str]]) -> Table:
    """Return a table that describes each distribution of scenes."""
    table = Table.grid(padding=(0, 2))
    for name, description in distributions:
        table.add_row(name, description)
    return table


def print_work(console: Console, study: "StudyExecution") -> None:
    """Print the number of runs, and how many of them exist already."""
    run_count, missing_count = study.plan.runs, study.missing_runs
    work = f"{run_count} simulated run{'s' if run_count > 1 else ''}, into {study.store.folder}"
    console.print(work, style="dim", soft_wrap=True)
    if study.changed_settings:
        change = f"{', '.join(study.changed_settings)} changed since the last use of this folder"
        console.print(f"{change}: {missing_count} of {run_count} runs are repeated", soft_wrap=True)
    elif not missing_count:
        console.print("all runs exist already", soft_wrap=True)
    elif missing_count < run_count:
        existing_count = run_count - missing_count
        console.print(f"{existing_count} runs exist already; the others follow", soft_wrap=True)


def print_results(
    console: Console, summaries: list["Summary"], comparisons: Iterable["PairedComparison"]
) -> None:
    """Print the results as a table, and a sentence for each comparison of methods."""
    console.print(build_result_table(summaries))
    for comparison in comparisons:
        console.print(describe_comparison(comparison), soft_wrap=True)
