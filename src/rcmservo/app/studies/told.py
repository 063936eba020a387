"""What the terminal tells of a study."""

import math
from typing import TYPE_CHECKING

from rich.table import Table

if TYPE_CHECKING:
    from rcmservo.study.told.statistics import Interval
    from rcmservo.study.told.summary import Comparison, Summary


def results(rows: list["Summary"]) -> Table:
    """What the terminal shows of a study."""
    table = Table("method", "scenes", "engine", "success", "to 1 mm", "error", "/ bound", "stops")
    for row in rows:
        stops = [f"{name} {count}" for name, count in row.stops.items()]
        table.add_row(
            row.method,
            row.condition,
            row.engine,
            f"{_spread(row.success, '.1f', 100.0)} %",
            f"{_spread(row.time_median_s, '.2f')} s",
            f"{_spread(row.pose_median_mm, '.3f')} mm",
            _spread(row.ratio_rms, ".2f"),
            ", ".join(stops) or "–",
        )
    return table


def beside(one: "Comparison") -> str:
    """A method beside the first one, in a sentence."""
    return (
        f"{one.method} beside {one.beside}, {one.condition}, {one.pairs} pairs: success "
        f"{_spread(one.success, '+.1f', 100.0)} % points, to 1 mm {_spread(one.time_s, '+.2f')} s, "
        f"error {_spread(one.pose_mm, '+.3f')} mm"
    )


def _spread(one: "Interval", form: str, times: float = 1.0) -> str:
    """A number and its interval."""
    if math.isnan(one.value):
        return "–"
    value, low, high = (_number(times * x, form) for x in one)
    return f"{value} ({low} to {high})"


def _number(value: float, form: str) -> str:
    """A number; of a time that never came, or of a difference to one, that it is without end."""
    if math.isinf(value):
        return "never" if "+" not in form else f"{value:+f}".replace("inf", "∞")
    return format(value, form)
