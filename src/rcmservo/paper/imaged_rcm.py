"""Experiment `imaged-rcm`: accuracy of (16) as printed, and with the built-in refinement.

A tool rotates in the image about the imaged RCM, which is the origin here. Marker 1 is r px from it
and marker 2 another d px, both with noise in u and v. The normal of a line through them has an
error of about √2 noise/d rad. It has two effects on (16): o_c scatters, and o_c is biased towards
the tool; the bias grows as the angular span of the lines shrinks.
"""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.geometry.imaged_rcm import intersect_lines, solve_imaged_rcm
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.imaged_lines import REFINEMENTS, markers
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import rms

VARIED = {
    "H": "number of lines H",
    "span": "span of the lines' angles [°]",
    "noise": "noise of the markers [px]",
}
"""Settings of the lines that are varied, one at a time."""
FITS = {"printed": "(16)", "refined": "(16), then refinement"}


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(f"over-{name}", partial(accuracy, settings=settings, varied=name), cost=3.0)
        for name in VARIED
    ]


def accuracy(settings: Settings, varied: str) -> dict[str, TaskResult]:
    """Return rms error and bias towards the tool (px) of o_c, by fit, over a varied setting."""
    samples = [
        sample(Settings(**{**vars(settings), varied: value})) for value in _values(settings, varied)
    ]

    def errors_of(i: int) -> TaskResult:
        errors = [one[:, i] for one in samples]
        return {
            "rms": np.array([rms(np.linalg.norm(error, axis=1)) for error in errors]),
            "bias": np.array([np.mean(error[:, 0]) for error in errors]),
        }

    return {fit: errors_of(i) for i, fit in enumerate(FITS)}


def _values(settings: Settings, varied: str) -> Sequence[float]:
    return getattr(settings, f"{varied}_values")


def sample(lines: Settings) -> Floats:
    """Return errors (draws, 2, 2) of o_c by each fit, as [towards the tool, across] in px."""
    random = np.random.default_rng(0)
    errors, span = np.empty((lines.draws, 2, 2)), float(np.radians(1.0)) * lines.span
    for error in errors:
        middle = random.uniform(-np.pi, np.pi)
        angles = middle + np.linspace(-0.5, 0.5, lines.H) * span
        observed = markers(angles, lines.r, lines.d, lines.noise, random)
        c, s = np.cos(middle), np.sin(middle)
        aligned = np.array([[c, s], [-s, c]])
        error[0] = aligned @ intersect_lines(observed, lines.H, True)[0]
        error[1] = aligned @ solve_imaged_rcm(observed, lines.H, REFINEMENTS, False)[0]
    return errors


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    H, span = results["over-H"], results["over-span"]
    printed, refined = span["printed"], span["refined"]
    usual, narrow = (settings.span_values.index(x) for x in (settings.span, settings.judged_span))
    yield Measurement(
        "lines-give-o_c",
        printed["rms"][usual],
        [0],
        trials=settings.draws,
        bound=settings.tolerance,
        confirmed=printed["rms"][0] > settings.tolerance,
        bias=printed["bias"][usual],
        narrowest=printed["rms"][0],
        refined=refined["rms"][usual],
    )
    bias = H["printed"]["bias"]
    yield Measurement(
        "falls-as-average",
        exponent(settings.H_values, H["printed"]["rms"]),
        [0],
        trials=settings.draws,
        confirmed=bias[-1] > 0.7 * bias[settings.H_values.index(settings.H)],
        bias=bias[-1],
        lines=settings.H_values[-1],
    )
    slope = exponent(settings.H_values, H["refined"]["rms"])
    yield Measurement("refined-falls", slope, [0], trials=settings.draws)
    before, after = printed["bias"][narrow], refined["bias"][narrow]
    yield Measurement(
        "no-bias",
        abs(after / before),
        [0],
        trials=settings.draws,
        confirmed=before > 10.0,
        before=before,
        after=after,
    )


def exponent(x: Sequence[float], y: Floats) -> float:
    """Return the exponent e of y ∝ x^e, by least squares on the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    panels = [_panel(settings, results, name, label) for name, label in VARIED.items()]
    yield ReportFigure("rcm-accuracy", [0], Figure("Accuracy of the imaged RCM", panels, columns=2))


def _panel(settings: Settings, results: Results, varied: str, label: str) -> Panel:
    x, curves, labelled = _values(settings, varied), list[Curve](), varied == "H"
    for style, (fit, name) in enumerate(FITS.items()):
        found = results[f"over-{varied}"][fit]
        curves.append(make_curve(f"{name}: rms" if labelled else "", x, found["rms"], style))
        words = f"{name}: |bias|" if labelled else ""
        curves.append(make_curve(words, x, np.abs(found["bias"]), style, marks=True))
    limits = (0.02, 500.0)
    return Panel(label, "error of $o_c$ [px]", curves, log_x=True, log_y=True, y_limits=limits)
