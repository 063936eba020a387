"""The saturated potential action, Fig. 5, in both readings of (32), and what each does to the
closed loop (33).

As printed, V is ½b|Δy| beyond b: continuous, but its gradient drops from b to b/2 there. Fig. 5 and
the word "saturated" ask for V = b|Δy| − ½b², whose gradient stays at b.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Experiment, Results, Shown, Task
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.controller import potential, potential_gradient

READINGS = {"continuous": False, "printed": True}


@dataclass(frozen=True)
class Settings:
    """``figure_bound`` b of Fig. 5; ``gain`` k 1/s and ``bound`` b px of the experiments, from
    ``error`` px."""

    figure_bound: float = 40.0
    reach: float = 100.0
    gain: float = 0.1
    bound: float = 10.0
    error: float = 80.0
    step: float = 0.01
    duration: float = 250.0


def tasks(settings: Settings) -> list[Task]:
    return [Task("action", action, {"settings": settings})]


def action(folder: Path, settings: Settings) -> dict[str, Any]:
    """Both readings: V, its gradient, the gradient's largest jump, V's largest jump, and (33)
    integrated."""
    del folder
    deltas = np.linspace(-settings.reach, settings.reach, 2001)
    values: dict[str, Any] = {"deltas": deltas.tolist()}
    for name, printed in READINGS.items():
        V, gradient = sampled(deltas, settings.figure_bound, printed)
        error = fall(settings, printed)
        small = error < 0.02 * settings.error
        values[name] = {
            "V": V.tolist(),
            "gradient": gradient.tolist(),
            "jump": float(np.max(np.abs(np.diff(gradient)))),
            "V_jump": float(np.max(np.abs(np.diff(V)))),
            "error": error.tolist(),
            "time_to_2_percent": float(np.argmax(small) * settings.step) if small.any() else None,
        }
    return values


def sampled(deltas: Floats, bound: float, printed: bool) -> tuple[Floats, Floats]:
    """V and ∂V/∂y of one component at the errors `deltas` (n,)."""
    bounds, still = np.array([bound] * 3), 0.0
    rows = [np.array([delta, still, still]) for delta in deltas]
    V = np.array([potential(row, bounds, printed) for row in rows])
    gradient = np.array([potential_gradient(row, bounds, printed)[0] for row in rows])
    return V, gradient


def fall(settings: Settings, printed: bool) -> Floats:
    """The error over time under (33), ẏ = −k ∂V/∂y, with a perfect Jacobian."""
    bounds = np.array([settings.bound] * 3)
    delta = np.array([settings.error, 0.0, 0.0])
    errors = np.empty(round(settings.duration / settings.step))
    for i in range(len(errors)):
        errors[i] = delta[0]
        delta = delta - settings.step * settings.gain * potential_gradient(delta, bounds, printed)
    return errors


def chapter(settings: Settings, results: Results) -> Chapter:
    values = results["action"].values
    smooth, printed = values["continuous"], values["printed"]
    sample = 2.0 * settings.reach / 2000.0
    slow = (
        "(32) as printed halves the action beyond b, so that the error falls at half the "
        "speed until there"
    )
    claims = [
        Claim(
            "the action ∂V/∂y is continuous: it saturates at b, as Fig. 5 shows",
            "Fig. 5",
            smooth["jump"],
            "px",
            "<=",
            1.01 * sample,
            [],
            detail="largest step between errors 0.1 px apart, of V = b|Δy| − ½b² beyond b (our "
            "default)",
            figure="fig-5",
        ),
        Claim(
            "the action of (32) as it is printed is continuous too",
            "(32)",
            printed["jump"],
            "px",
            "<=",
            1.01 * sample,
            [],
            remark=f"it jumps from b to b/2 at |Δy| = b = {settings.figure_bound:g} px; offered "
            f"as potential = printed",
            figure="fig-5",
            trap="T0",
            confirmed=printed["jump"] > 0.4 * settings.figure_bound,
        ),
        Claim(
            "V of (32) is continuous in both readings",
            "(32)",
            max(smooth["V_jump"], printed["V_jump"]),
            "px²",
            "<=",
            1.01 * sample * settings.figure_bound,
            [],
            figure="fig-5",
        ),
        Claim(
            f"with k = {settings.gain:g} and b = {settings.bound:g} px an error of "
            f"{settings.error:g} px is below 2 % "
            "after about 90 s",
            "(33)",
            smooth["time_to_2_percent"],
            "s",
            "<=",
            90.0,
            [],
            detail=f"as printed {printed['time_to_2_percent']:.0f} s: {slow}",
            figure="potential-loop",
            trap="T5",
            confirmed=smooth["time_to_2_percent"] > 80.0,
        ),
    ]
    return Chapter(claims, [_figure_5(settings, values), _loop(settings, values)])


def _figure_5(settings: Settings, values: dict[str, Any]) -> Shown:
    def curves(key: str) -> list[Curve]:
        return [
            curve(label, values["deltas"], values[name][key], style)
            for style, (name, label) in enumerate(LABELS.items())
        ]

    panels = [
        Panel("$\\Delta y_i$ [px]", "$\\partial V_i / \\partial y_i$ [px]", curves("gradient")),
        Panel("$\\Delta y_i$ [px]", "$V_i$ [px²]", curves("V")),
    ]
    figure = Figure(
        f"Saturated potential action, $b_i$ = {settings.figure_bound:g} px", panels, columns=2
    )
    caption = (
        "The action and its potential: continuous, as the figure in the paper shows it, "
        "and as (32) is printed."
    )
    return Shown("fig-5", "Fig. 5", caption, [], figure)


LABELS = {"continuous": "continuous (Fig. 5)", "printed": "as (32) is printed"}


def _loop(settings: Settings, values: dict[str, Any]) -> Shown:
    time = np.arange(round(settings.duration / settings.step)) * settings.step
    curves = [
        curve(label, time, values[name]["error"], style)
        for style, (name, label) in enumerate(LABELS.items())
    ]
    panel = Panel(
        "time [s]", "$|\\Delta y_i|$ [px]", curves, levels=[("2 %", 0.02 * settings.error)]
    )
    caption = (
        f"(33) with k = {settings.gain:g}, b = {settings.bound:g} px and a perfect "
        f"Jacobian, in both readings."
    )
    return Shown(
        "potential-loop", "(33)", caption, [], Figure("Error under either reading of (32)", [panel])
    )


EXPERIMENT = Experiment(
    name="potential",
    title="The saturated potential action",
    about="Fig. 5 and (32), in both readings.",
    whole=Settings(),
    quick=Settings(),
    tasks=tasks,
    chapter=chapter,
)
