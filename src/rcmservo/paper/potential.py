"""Experiment `potential`: the saturated potential action, Fig. 5, and the error under (33).

Equation (32) has two readings. As printed, V = ½b|Δy| beyond b: V is continuous, but its gradient
drops from b to b/2. Fig. 5 and the word "saturated" require V = b|Δy| − ½b², with a gradient of b.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import potential, potential_gradient
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult

READING_NAMES = {"continuous": "continuous (Fig. 5)", "printed": "as (32) is printed"}
SMALL_FRACTION = 0.02
"""Fraction of the initial error below which the error counts as regulated."""


def tasks(settings: Settings) -> list[Task]:
    return [Task("action", partial(action, settings=settings))]


def action(settings: Settings) -> TaskResult:
    """Return V, its gradient, their largest steps, and the integral of (33), in both readings."""
    reach: float = settings.reach
    errors = np.linspace(-reach, reach, 2001)
    readings = {name: reading(settings, errors, name == "printed") for name in READING_NAMES}
    return {"errors": errors, **readings}


def reading(settings: Settings, errors: Floats, printed: bool) -> TaskResult:
    """Return V (px²) and ∂V/∂y (px) of one component in one reading of (32), and (33) over time."""
    bounds = np.full(3, settings.figure_bound)
    rows = [np.array([error, 0.0, 0.0]) for error in errors]
    V = np.array([potential(row, bounds, printed) for row in rows])
    gradient = np.array([potential_gradient(row, bounds, printed)[0] for row in rows])
    fall = closed_loop(settings, printed)
    return {
        "V": V,
        "gradient": gradient,
        "jump": np.max(np.abs(np.diff(gradient))),
        "V_jump": np.max(np.abs(np.diff(V))),
        "fall": fall,
        "time_to_small": first_below(SMALL_FRACTION * settings.error, fall) * settings.step,
    }


def closed_loop(settings: Settings, printed: bool) -> Floats:
    """Return the error over time under (33), ẏ = −k ∂V/∂y, with a perfect Jacobian."""
    bounds, delta = np.full(3, settings.bound), np.array([settings.error, 0.0, 0.0])
    errors = np.empty(round(settings.duration / settings.step))
    for i in range(len(errors)):
        errors[i] = delta[0]
        delta = delta - settings.step * settings.gain * potential_gradient(delta, bounds, printed)
    return errors


def first_below(bound: float, errors: Floats) -> float:
    """Return the index of the first error below `bound`; infinite if there is none."""
    below = np.flatnonzero(errors < bound)
    return float(below[0]) if len(below) else np.inf


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    found = results["action"]
    continuous, printed = found["continuous"], found["printed"]
    spacing = 2.0 * settings.reach / 2000.0
    yield Measurement("saturates", continuous["jump"], bound=1.01 * spacing, spacing=spacing)
    jumps = printed["jump"] > 0.4 * settings.figure_bound
    yield Measurement("printed", printed["jump"], bound=1.01 * spacing, confirmed=jumps)
    jump = max(continuous["V_jump"], printed["V_jump"])
    yield Measurement("continuous", jump, bound=1.01 * spacing * settings.figure_bound)
    time, as_printed = continuous["time_to_small"], printed["time_to_small"]
    yield Measurement("time", time, confirmed=time > 80.0, printed=as_printed)


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    found = results["action"]
    labels = {"gradient": "$\\partial V_i / \\partial y_i$ [px]", "V": "$V_i$ [px²]"}
    panels = [
        Panel("$\\Delta y_i$ [px]", label, _curves(found, found["errors"], name))
        for name, label in labels.items()
    ]
    title = f"Saturated potential action, $b_i$ = {settings.figure_bound:g} px"
    yield ReportFigure("fig-5", [], Figure(title, panels, columns=2))
    time = np.arange(round(settings.duration / settings.step)) * settings.step
    levels = [("2 %", SMALL_FRACTION * settings.error)]
    panel = Panel("time [s]", "$|\\Delta y_i|$ [px]", _curves(found, time, "fall"), levels=levels)
    yield ReportFigure("potential-loop", [], Figure("Error under either reading of (32)", [panel]))


def _curves(found: TaskResult, x: Floats, name: str) -> list[Curve]:
    labels = enumerate(READING_NAMES.items())
    return [make_curve(label, x, found[key][name], style) for style, (key, label) in labels]
