"""Terminal output of a study."""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from rcmservo.study.execution.run_study import StudyExecution
    from rcmservo.study.report.statistics import Interval
    from rcmservo.study.report.summary import PairedComparison, Summary

NUMBER_COLUMNS = "success, %", "to 1 mm, s", "error, mm", "/ bound"
"""Titles of the columns of numbers: medians of time and error, and the rms of the ratio."""


def build_distribution_table(distributions: Iterable[tuple[str, str]]) -> Table:
    """Return a table that describes each distribution of scenes."""
    table = Table.grid(padding=(0, 2))
    for name, words in distributions:
        table.add_row(name, words)
    return table


def print_work(out: Console, work: "StudyExecution") -> None:
    """Print the number of runs, and how many of them exist already."""
    runs, left = work.plan.runs, work.missing_runs
    words = f"{runs} simulated run{'s' if runs > 1 else ''}, into {work.store.folder}"
    out.print(words, style="dim", soft_wrap=True)
    if work.changed_settings:
        words = f"{', '.join(work.changed_settings)} changed since the last use of this folder"
        out.print(f"{words}: {left} of {runs} runs are repeated", soft_wrap=True)
    elif not left:
        out.print("all runs exist already", soft_wrap=True)
    elif left < runs:
        out.print(f"{runs - left} runs exist already; the others follow", soft_wrap=True)


def build_result_table(rows: list["Summary"]) -> Table:
    """Return the results as a table, each number with its interval below."""
    table = Table(show_lines=True)
    for words in ("method\nengine", "scenes"):
        table.add_column(words, overflow="fold")
    for words in NUMBER_COLUMNS:
        table.add_column(words, overflow="fold", justify="right")
    table.add_column("first stops", overflow="fold")
    for row in rows:
        stops = [f"{name} {count}" for name, count in row.stops.items()]
        table.add_row(
            f"{row.method}\n{row.engine}",
            row.condition,
            _format_two_lines(row.success, ".1f", 100.0),
            _format_two_lines(row.time_median_s, ".2f", 1.0, "never"),
            _format_two_lines(row.pose_median_mm, ".3f"),
            _format_two_lines(row.ratio_rms, ".2f"),
            "\n".join(stops) or "–",
        )
    return table


def describe_comparison(one: "PairedComparison") -> str:
    """Return a sentence that compares a method with the first one."""
    return (
        f"{one.method} compared with {one.beside}, {one.condition}, {one.pairs} pairs: success "
        f"{_format_one_line(one.success, '+.1f', '% points', 100.0)}, {_describe_time_gain(one)}, "
        f"error {_format_one_line(one.pose_mm, '+.3f', 'mm')}"
    )


def _describe_time_gain(one: "PairedComparison") -> str:
    """Return the gain in the time to 1 mm, or the only method that mostly reaches 1 mm."""
    if math.isinf(one.time_s.value):
        only = one.beside if one.time_s.value > 0.0 else one.method
        return f"mostly only {only} reaches 1 mm"
    return f"to 1 mm {_format_one_line(one.time_s, '+.2f', 's')}"


def format_number(value: float, form: str, infinity: str = "∞") -> str:
    """Return a number, or a text for infinity."""
    if math.isinf(value):
        return infinity if "+" not in form else f"{value:+f}".replace("inf", "∞")
    return format(value, form)


def _format_two_lines(one: "Interval", form: str, scale: float = 1.0, infinity: str = "∞") -> str:
    """Return a number with its interval in the line below."""
    value, low, high = (format_number(scale * x, form, infinity) for x in one)
    if math.isnan(one.value):
        return "–"
    return value if low == high == value else f"{value}\n{low} to {high}"


def _format_one_line(one: "Interval", form: str, unit: str, scale: float = 1.0) -> str:
    """Return a number with its interval and unit; a dash for NaN."""
    if math.isnan(one.value):
        return "–"
    value, low, high = (format_number(scale * x, form) for x in one)
    between = "" if low == high == value else f" ({low} to {high})"
    return f"{value}{between} {unit}"
