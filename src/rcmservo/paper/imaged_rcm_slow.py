"""Experiment `imaged-rcm-slow`: the imaged RCM (16) in slow motion.

As printed, (16) uses the last H lines, which are nearly identical in slow motion. The built-in
method selects lines by their leverage on o_c, and refines the solution.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.imaged_rcm import (
    ImagedRcm,
    intersect_lines,
    solve_imaged_rcm,
    update_imaged_rcm,
)
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.imaged_lines import REFINEMENTS, markers
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, finite, rms
from rcmservo.study.report.statistics import format_finite

MAX_CONDITION = ImagedRcm().max_condition
FITS = {
    "window": "last H lines, (16) as printed",
    "window_refined": "last H lines, refined",
    "chosen": "selected lines, (16)",
    "chosen_refined": "selected lines, refined",
}


def tasks(settings: Settings) -> list[Task]:
    return Task.per_seed(
        "slow", partial(slow_turn, settings=settings), range(settings.seeds), cost=3.0
    )


def frame_times(settings: Settings) -> Floats:
    """Return the times (n,) of the frames in s."""
    return np.arange(round(settings.duration * settings.frame_rate)) / settings.frame_rate


def slow_turn(settings: Settings, seed: int) -> TaskResult:
    """Return the error (px) of o_c by each fit in each frame.

    ``gate`` is the error of the built-in method in the first frame that meets its limit on the
    condition number of (16); None if no frame does.
    """
    random, turned = np.random.default_rng(seed), float(np.radians(1.0)) * settings.speed
    angles = turned * frame_times(settings)
    observed = markers(angles, settings.r, settings.d, settings.noise, random)
    selected, count = ImagedRcm(lines=settings.H).init()
    window, window_count = selected, count
    errors: dict[str, list[float]] = {fit: [] for fit in FITS}
    gate: float | None = None
    for line in observed:
        points = line.reshape(2, 2)
        window, window_count, printed, _ = update_imaged_rcm(window, window_count, points, 0, True)
        selected, count, refined, condition = update_imaged_rcm(
            selected, count, points, REFINEMENTS, False
        )
        found = {
            "window": printed,
            "window_refined": solve_imaged_rcm(window, window_count, REFINEMENTS, False)[0],
            "chosen": intersect_lines(selected, count, False)[0],
            "chosen_refined": refined,
        }
        for fit, o_c in found.items():
            errors[fit].append(float(np.linalg.norm(o_c)))
        if gate is None and condition <= MAX_CONDITION:
            gate = errors["chosen_refined"][-1]
    return {"errors": {fit: np.array(some) for fit, some in errors.items()}, "gate": gate}


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    turns = results.per_seed("slow", seeds)
    settled = round(settings.settled * settings.frame_rate)
    late = {fit: rms(np.array([turn["errors"][fit][settled:] for turn in turns])) for fit in FITS}
    lines, bound = settings.H / settings.frame_rate * settings.speed, settings.tolerance
    yield Measurement(
        "last-lines",
        late["window"],
        seeds,
        bound=bound,
        confirmed=late["window"] > 0.5 * settings.r,
        window=lines,
        refined=late["window_refined"],
    )
    yield Measurement("chosen-lines", late["chosen"], seeds, bound=bound)
    turned = round(settings.span / settings.speed * settings.frame_rate)
    gates = finite(column(turns, "gate"))
    low, high = (format_finite(f(gates), ".0f") if len(gates) else "–" for f in (np.min, np.max))
    yield Measurement(
        "chosen-refined",
        late["chosen_refined"],
        seeds,
        bound=bound,
        early=rms([turn["errors"]["chosen_refined"][turned] for turn in turns]),
        condition=MAX_CONDITION,
        low=low,
        high=high,
    )


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    seeds = range(settings.seeds)
    turns = results.per_seed("slow", seeds)
    middle = {fit: np.median([turn["errors"][fit] for turn in turns], axis=0) for fit in FITS}
    curves = [
        make_curve(label, frame_times(settings), middle[fit], style)
        for style, (fit, label) in enumerate(FITS.items())
    ]
    panel = Panel("time [s]", "error of $o_c$ [px]", curves, log_y=True)
    yield ReportFigure("rcm-slow", seeds, Figure("The imaged RCM in slow motion", [panel]))
