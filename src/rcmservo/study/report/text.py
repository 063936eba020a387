"""Tables and sentences with the numbers of a study, for a terminal or as plain text."""

import math
from typing import TYPE_CHECKING

from rich.table import Table

if TYPE_CHECKING:
    from rcmservo.study.report.statistics import Interval
    from rcmservo.study.report.summary import PairedComparison, Summary

NUMBER_COLUMNS = "success, %", "to 1 mm, s", "error, mm", "/ bound"
"""Titles of the columns of numbers: medians of time and error, and the rms of the ratio."""


def build_result_table(rows: list["Summary"]) -> Table:
    """Return the results as a table, each number with its interval below."""
    table = Table(show_lines=True)
    for title in ("method\nengine", "scenes\nruns"):
        table.add_column(title, overflow="fold")
    for title in NUMBER_COLUMNS:
        table.add_column(title, overflow="fold", justify="right")
    table.add_column("first stops", overflow="fold")
    for row in rows:
        stops = [f"{name} {count}" for name, count in row.stops.items()]
        table.add_row(
            f"{row.method}\n{row.engine}",
            f"{row.condition}\n{row.runs}",
            _format_two_lines(row.success, ".1f", 100.0),
            _format_two_lines(row.time_median_s, ".2f", 1.0, "never"),
            _format_two_lines(row.pose_median_mm, ".3f"),
            _format_two_lines(row.ratio_rms, ".2f"),
            "\n".join(stops) or "–",
        )
    return table


def describe_comparison(comparison: "PairedComparison") -> str:
    """Return a sentence that compares a method with the first one."""
    success = _format_one_line(comparison.success, "+.1f", "% points", 100.0)
    error = _format_one_line(comparison.pose_mm, "+.3f", "mm")
    return (
        f"{comparison.method} compared with {comparison.beside}, {comparison.condition}, "
        f"{comparison.pairs} pairs: success {success}, {_describe_time_gain(comparison)}, "
        f"error {error}"
    )


def _describe_time_gain(comparison: "PairedComparison") -> str:
    """Return the gain in the time to 1 mm, or the only method that mostly reaches 1 mm."""
    gain_s = comparison.time_s
    if math.isinf(gain_s.value):
        only_method = comparison.beside if gain_s.value > 0.0 else comparison.method
        return f"mostly only {only_method} reaches 1 mm"
    return f"to 1 mm {_format_one_line(gain_s, '+.2f', 's')}"


def format_number(value: float, form: str, infinity: str = "∞") -> str:
    """Return a number in a format such as .2f, or a text for infinity."""
    if math.isinf(value):
        return infinity if "+" not in form else f"{value:+f}".replace("inf", "∞")
    return format(value, form)


def _format_two_lines(
    interval: "Interval", form: str, scale: float = 1.0, infinity: str = "∞"
) -> str:
    """Return a number with its interval in the line below."""
    value, low, high = (format_number(scale * x, form, infinity) for x in interval)
    if math.isnan(interval.value):
        return "–"
    return value if low == high == value else f"{value}\n{low} to {high}"


def _format_one_line(interval: "Interval", form: str, unit: str, scale: float = 1.0) -> str:
    """Return a number with its interval and unit; a dash for NaN."""
    number, *limits = _format_two_lines(interval, form, scale).split("\n")
    if number == "–":
        return number
    return f"{number} ({limits[0]}) {unit}" if limits else f"{number} {unit}"
