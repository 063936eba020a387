"""Check of eq. (32), the saturated potential action of Fig. 5, and of the error under eq. (33).

Experiment `potential`; the controller itself is in control/saturated_controller.py. Equation (32)
has two readings. As printed, V = ½b|Δy| beyond b: V is continuous, but its gradient drops from b to
b/2. Fig. 5 and the word "saturated" require V = b|Δy| − ½b², with a gradient of b.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from rcmservo.control.saturated_controller import compute_potential, compute_potential_gradient
from rcmservo.figures.charts import Figure, Panel
from rcmservo.interfaces import Floats
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import curve_per_label

READING_NAMES = {"continuous": "continuous (Fig. 5)", "printed": "as (32) is printed"}
SMALL_FRACTION = 0.02
"""Fraction of the initial error below which the error counts as regulated."""
ERROR_COUNT = 2001
"""Number of errors at which V and its gradient are evaluated."""


def tasks(settings: Settings) -> list[Task]:
    return [Task("action", partial(evaluate_readings, settings=settings))]


def evaluate_readings(settings: Settings) -> TaskResult:
    """Return the results of `evaluate_reading` for both readings, and their errors (px)."""
    errors = np.linspace(-float(settings.reach), float(settings.reach), ERROR_COUNT)
    readings = {
        name: evaluate_reading(settings, errors, name == "printed") for name in READING_NAMES
    }
    return {"errors": errors, **readings}


def evaluate_reading(settings: Settings, errors: Floats, printed: bool) -> TaskResult:
    """Return V (px²) and ∂V/∂y (px) of one component in one reading of (32), and (33) over time.

    ``V_jump`` and ``jump`` are the largest steps of V and of its gradient between two errors.
    """
    bounds = np.full(3, settings.figure_bound)
    rows = [np.array([error, 0.0, 0.0]) for error in errors]
    V = np.array([compute_potential(row, bounds, printed) for row in rows])
    gradient = np.array([compute_potential_gradient(row, bounds, printed)[0] for row in rows])
    error_over_time = integrate_closed_loop(settings, printed)
    steps_to_small = first_below(SMALL_FRACTION * settings.error, error_over_time)
    return {
        "V": V,
        "gradient": gradient,
        "jump": np.max(np.abs(np.diff(gradient))),
        "V_jump": np.max(np.abs(np.diff(V))),
        "fall": error_over_time,
        "time_to_small": steps_to_small * settings.step,
    }


def integrate_closed_loop(settings: Settings, printed: bool) -> Floats:
    """Return the error over time under (33), ẏ = −k ∂V/∂y, with a perfect Jacobian."""
    bounds, delta = np.full(3, settings.bound), np.array([settings.error, 0.0, 0.0])
    errors = np.empty(round(settings.duration / settings.step))
    for i in range(len(errors)):
        errors[i] = delta[0]
        delta = delta - settings.step * settings.gain * compute_potential_gradient(
            delta, bounds, printed
        )
    return errors


def first_below(bound: float, errors: Floats) -> float:
    """Return the index of the first error below `bound`; infinite if there is none."""
    below = np.flatnonzero(errors < bound)
    return float(below[0]) if len(below) else np.inf


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    readings = results["action"]
    continuous, printed = readings["continuous"], readings["printed"]
    spacing = 2.0 * settings.reach / (ERROR_COUNT - 1.0)
    yield Measurement("saturates", continuous["jump"], bound=1.01 * spacing, spacing=spacing)
    jumps = printed["jump"] > 0.4 * settings.figure_bound
    yield Measurement("printed", printed["jump"], bound=1.01 * spacing, confirmed=jumps)
    V_jump = max(continuous["V_jump"], printed["V_jump"])
    yield Measurement("continuous", V_jump, bound=1.01 * spacing * settings.figure_bound)
    time, printed_time = continuous["time_to_small"], printed["time_to_small"]
    yield Measurement("time", time, confirmed=time > 80.0, printed=printed_time)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    readings = results["action"]

    def draw_panel(x: Floats, x_label: str, name: str, y_label: str, **options: Any) -> Panel:
        curves = curve_per_label(READING_NAMES, lambda reading: (x, readings[reading][name]))
        return Panel(x_label, y_label, curves, **options)

    labels = {"gradient": "$\\partial V_i / \\partial y_i$ [px]", "V": "$V_i$ [px²]"}
    panels = [
        draw_panel(readings["errors"], "$\\Delta y_i$ [px]", name, label)
        for name, label in labels.items()
    ]
    title = f"Saturated potential action, $b_i$ = {settings.figure_bound:g} px"
    yield PaperFigure("fig-5", [], Figure(title, panels, columns=2))
    time = np.arange(round(settings.duration / settings.step)) * settings.step
    levels = [("2 %", SMALL_FRACTION * settings.error)]
    panel = draw_panel(time, "time [s]", "fall", "$|\\Delta y_i|$ [px]", levels=levels)
    yield PaperFigure("potential-loop", [], Figure("Error under either reading of (32)", [panel]))
