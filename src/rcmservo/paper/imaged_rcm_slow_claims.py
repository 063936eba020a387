"""Check of eq. (16) in slow motion, where the last H lines are nearly identical.

Experiment `imaged-rcm-slow`; the solution itself is in geometry/imaged_rcm.py. As printed, (16)
uses the last H lines. The built-in method uses all lines and subtracts the noise.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.figures.charts import Figure, Panel
from rcmservo.geometry.imaged_rcm import (
    ImagedRcm,
    add_line,
    intersect_lines,
    solve_sums,
    sum_lines,
)
from rcmservo.interfaces import Floats
from rcmservo.paper.imaged_rcm_claims import observe_markers
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, curve_per_label, finite, rms
from rcmservo.study.report.statistics import format_finite

MAX_CONDITION = ImagedRcm().max_condition
FIT_NAMES = {
    "window": "last H lines, (16) as printed",
    "window_refined": "last H lines, without noise",
    "all": "all lines, (16)",
    "all_refined": "all lines, without noise",
}


def tasks(settings: Settings) -> list[Task]:
    work = partial(turn_slowly, settings=settings)
    return Task.per_seed("slow", work, range(settings.seeds), cost=3.0)


def frame_times(settings: Settings) -> Floats:
    """Return the times (n,) of the frames in s."""
    return np.arange(round(settings.duration * settings.frame_rate)) / settings.frame_rate


def turn_slowly(settings: Settings, seed: int) -> TaskResult:
    """Return the error (px) of o_c by each fit in each frame.

    ``gate`` is the error of the built-in method in the first frame that meets its limit on the
    condition number of (16); None if no frame does.
    """
    random = np.random.default_rng(seed)
    angles = float(np.radians(1.0)) * settings.speed * frame_times(settings)
    observed = observe_markers(angles, settings.r, settings.d, settings.noise, random)
    sums, _ = ImagedRcm().init()
    errors: dict[str, list[float]] = {fit: [] for fit in FIT_NAMES}
    gate: float | None = None
    for i, line in enumerate(observed):
        add_line(sums, line.reshape(2, 2))
        window, refined = observed[max(i + 1 - settings.H, 0) : i + 1], solve_sums(sums)
        o_c = {
            "window": intersect_lines(window).o_c,
            "window_refined": solve_sums(sum_lines(window)).o_c,
            "all": intersect_lines(observed[: i + 1]).o_c,
            "all_refined": refined.o_c,
        }
        for fit in FIT_NAMES:
            errors[fit].append(float(np.linalg.norm(o_c[fit])))
        if gate is None and refined.condition <= MAX_CONDITION:
            gate = errors["all_refined"][-1]
    return {"errors": {fit: np.array(values) for fit, values in errors.items()}, "gate": gate}


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds, bound = range(settings.seeds), settings.tolerance
    runs = results.per_seed("slow", seeds)
    errors = {fit: np.array([run["errors"][fit] for run in runs]) for fit in FIT_NAMES}
    settled = round(settings.settled * settings.frame_rate)
    late = {fit: rms(values[:, settled:]) for fit, values in errors.items()}
    is_useless, window = late["window"] > 0.5 * settings.r, settings.H / settings.frame_rate
    texts = Texts(window=window * settings.speed, refined=late["window_refined"])
    yield Measurement(
        "last-lines", late["window"], seeds, bound=bound, confirmed=is_useless, **texts
    )
    yield Measurement("all-lines", late["all"], seeds, bound=bound)
    spanned = round(settings.span / settings.speed * settings.frame_rate)
    gates = finite(column(runs, "gate"))
    low, high = (format_finite(f(gates), ".0f") if len(gates) else "–" for f in (np.min, np.max))
    early = rms(errors["all_refined"][:, spanned])
    texts = Texts(early=early, condition=MAX_CONDITION, low=low, high=high)
    yield Measurement("all-refined", late["all_refined"], seeds, bound=bound, **texts)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    seeds = range(settings.seeds)
    runs, time = results.per_seed("slow", seeds), frame_times(settings)

    def over_time(fit: str) -> tuple[Floats, Floats]:
        return time, np.median([run["errors"][fit] for run in runs], axis=0)

    curves = curve_per_label(FIT_NAMES, over_time)
    panel = Panel("time [s]", "error of $o_c$ [px]", curves, log_y=True)
    yield PaperFigure("rcm-slow", seeds, Figure("The imaged RCM in slow motion", [panel]))
