"""The saturated potential action, Fig. 5, in both readings of (32), and what each does to the
closed loop (33).

As printed, V is ½b|Δy| beyond b: continuous, but its gradient drops from b to b/2 there. Fig. 5 and
the word "saturated" ask for V = b|Δy| − ½b², whose gradient stays at b.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.controller import potential, potential_gradient

LABELS = ("continuous (Fig. 5)", "as (32) is printed")
SMALL = 0.02
"""Share of the first error below which it counts as gone."""


@dataclass(frozen=True)
class Settings:
    """The bounds of Fig. 5 and of the experiments."""

    figure_bound: float = 40.0
    """b of Fig. 5."""
    reach: float = 100.0
    """px on either side that are shown."""
    gain: float = 0.1
    """k 1/s of the experiments."""
    bound: float = 10.0
    """b px of the experiments."""
    error: float = 80.0
    """px at the start of (33)."""
    step: float = 0.01
    """s."""
    duration: float = 250.0
    """s."""

    @property
    def spacing(self) -> float:
        """px between two errors at which the action is sampled."""
        return 2.0 * self.reach / 2000.0


@dataclass(frozen=True)
class Reading:
    """One reading of (32)."""

    V: JsonFloats
    """V px² of one component at every error sampled, with the bound of Fig. 5."""
    gradient: JsonFloats
    """∂V/∂y px of that component there."""
    jump: float
    """Largest step of the gradient, px."""
    V_jump: float
    """Largest step of V, px²."""
    error: JsonFloats
    """px over time under (33)."""
    time_to_small: float
    """s until the error counts as gone."""


@dataclass(frozen=True)
class PotentialAction:
    """Both readings of (32)."""

    deltas: JsonFloats
    """Errors px (n,) at which V and its gradient are sampled."""
    continuous: Reading
    """As Fig. 5 shows the action; our default."""
    printed: Reading
    """As (32) is printed."""


def tasks(settings: Settings) -> list[Task]:
    return [Task("action", partial(action, settings=settings))]


def action(folder: Path, settings: Settings) -> PotentialAction:
    """Both readings: V, its gradient, their largest steps, and (33) integrated."""
    del folder
    deltas = np.linspace(-settings.reach, settings.reach, 2001)
    return PotentialAction(
        deltas, reading(settings, deltas, printed=False), reading(settings, deltas, printed=True)
    )


def reading(settings: Settings, deltas: Floats, printed: bool) -> Reading:
    V, gradient = sampled(deltas, settings.figure_bound, printed)
    error = fall(settings, printed)
    return Reading(
        V=V,
        gradient=gradient,
        jump=float(np.max(np.abs(np.diff(gradient)))),
        V_jump=float(np.max(np.abs(np.diff(V)))),
        error=error,
        time_to_small=first_below(SMALL * settings.error, error) * settings.step,
    )


def first_below(bound: float, error: Floats) -> float:
    """Place of the first error below the bound; infinite if there is none."""
    below = np.flatnonzero(error < bound)
    return float(below[0]) if len(below) else np.inf


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
    found = results.of(PotentialAction, "action")
    claims = [
        action_saturates(settings, found),
        printed_action(settings, found),
        V_is_continuous(settings, found),
        takes_its_time(settings, found),
    ]
    return Chapter(claims, [_figure_5(settings, found), _loop(settings, found)])


def action_saturates(settings: Settings, found: PotentialAction) -> Claim:
    return Claim(
        "the action is continuous and saturates at b, as Fig. 5 shows: largest step between "
        f"errors {settings.spacing:g} px apart",
        "saturated",
        found.continuous.jump,
        "px",
        "<=",
        1.01 * settings.spacing,
        detail="of V = b|Δy| − ½b² beyond b (our default)",
        figure="fig-5",
    )


def printed_action(settings: Settings, found: PotentialAction) -> Claim:
    return Claim(
        "the action of (32) as it is printed is continuous too: largest step",
        "saturated",
        found.printed.jump,
        "px",
        "<=",
        1.01 * settings.spacing,
        remark=f"it jumps from b to b/2 at |Δy| = b = {settings.figure_bound:g} px; offered as "
        "potential = printed",
        figure="fig-5",
        trap="T0",
        confirmed=found.printed.jump > 0.4 * settings.figure_bound,
    )


def V_is_continuous(settings: Settings, found: PotentialAction) -> Claim:
    return Claim(
        "V of (32) is continuous in both readings: largest step",
        "saturated",
        max(found.continuous.V_jump, found.printed.V_jump),
        "px²",
        "<=",
        1.01 * settings.spacing * settings.figure_bound,
        figure="fig-5",
    )


def takes_its_time(settings: Settings, found: PotentialAction) -> Claim:
    time = found.continuous.time_to_small
    return Claim(
        f"with k = {settings.gain:g} and b = {settings.bound:g} px an error of "
        f"{settings.error:g} px is below 2 % after about 90 s",
        "gains",
        time,
        "s",
        "<=",
        90.0,
        follows=True,
        detail=f"as printed {found.printed.time_to_small:.0f} s: (32) as printed halves the "
        "action beyond b, so that the error falls at half the speed until there",
        figure="potential-loop",
        trap="T5",
        confirmed=time > 80.0,
    )


def _figure_5(settings: Settings, found: PotentialAction) -> Shown:
    readings = (found.continuous, found.printed)
    gradients = [
        curve(LABELS[style], found.deltas, one.gradient, style)
        for style, one in enumerate(readings)
    ]
    potentials = [
        curve(LABELS[style], found.deltas, one.V, style) for style, one in enumerate(readings)
    ]
    panels = [
        Panel("$\\Delta y_i$ [px]", "$\\partial V_i / \\partial y_i$ [px]", gradients),
        Panel("$\\Delta y_i$ [px]", "$V_i$ [px²]", potentials),
    ]
    title = f"Saturated potential action, $b_i$ = {settings.figure_bound:g} px"
    caption = (
        "The action and its potential: continuous, as the figure in the paper shows it, and as "
        "(32) is printed."
    )
    return Shown("fig-5", "Fig. 5", caption, [], Figure(title, panels, columns=2))


def _loop(settings: Settings, found: PotentialAction) -> Shown:
    time = np.arange(round(settings.duration / settings.step)) * settings.step
    curves = [
        curve(LABELS[style], time, one.error, style)
        for style, one in enumerate((found.continuous, found.printed))
    ]
    levels = [("2 %", SMALL * settings.error)]
    panel = Panel("time [s]", "$|\\Delta y_i|$ [px]", curves, levels=levels)
    caption = (
        f"(33) with k = {settings.gain:g}, b = {settings.bound:g} px and a perfect Jacobian, in "
        "both readings."
    )
    figure = Figure("Error under either reading of (32)", [panel])
    return Shown("potential-loop", "(33)", caption, [], figure)


EXPERIMENT = Experiment(
    name="potential",
    title="The saturated potential action",
    about="Fig. 5 and (32), in both readings.",
    whole=Settings(),
    quick=Settings(),
    tasks=tasks,
    chapter=chapter,
)
