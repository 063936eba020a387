"""Check of eq. (16): accuracy of the imaged RCM as printed, and without the part of the noise.

Experiment `imaged-rcm`; the solution itself is in geometry/imaged_rcm.py. A tool rotates in the
image about the imaged RCM, which is the origin here. Marker 1 is r px from it and marker 2 another
d px, both with noise in u and v. The normal of a line through them has an error of about √2 noise/d
rad. It has two effects on (16): o_c scatters, and o_c is biased towards the tool; the bias grows as
the angular span of the lines shrinks.
"""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.geometry.imaged_rcm import intersect_lines, solve_sums, sum_lines
from rcmservo.interfaces import Floats
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import rms

VARIED_SETTINGS = {
    "H": "number of lines H",
    "span": "span of the lines' angles [°]",
    "noise": "noise of the markers [px]",
}
"""Settings of the lines that are varied, one at a time."""
FIT_NAMES = {"printed": "(16)", "refined": "(16) without noise"}


def tasks(settings: Settings) -> list[Task]:
    work = partial(vary_setting, settings=settings)
    return [Task(f"over-{name}", partial(work, varied=name), cost=3.0) for name in VARIED_SETTINGS]


def vary_setting(settings: Settings, varied: str) -> dict[str, TaskResult]:
    """Return rms error and bias towards the tool (px) of o_c, by fit, over a varied setting."""
    values = getattr(settings, f"{varied}_values")
    samples = [sample_errors(Settings(**{**vars(settings), varied: value})) for value in values]
    return {
        fit: {
            "rms": np.array([rms(np.linalg.norm(errors[:, i], axis=1)) for errors in samples]),
            "bias": np.array([np.mean(errors[:, i, 0]) for errors in samples]),
        }
        for i, fit in enumerate(FIT_NAMES)
    }


def sample_errors(lines: Settings) -> Floats:
    """Return errors (draws, 2, 2) of o_c by each fit, as [towards the tool, across] in px."""
    random = np.random.default_rng(0)
    errors, span = np.empty((lines.draws, 2, 2)), float(np.radians(1.0)) * lines.span
    for error in errors:
        middle = random.uniform(-np.pi, np.pi)
        angles = middle + np.linspace(-0.5, 0.5, lines.H) * span
        observed = observe_markers(angles, lines.r, lines.d, lines.noise, random)
        c, s = np.cos(middle), np.sin(middle)
        aligned = np.array([[c, s], [-s, c]])
        error[0] = aligned @ intersect_lines(observed).o_c
        error[1] = aligned @ solve_sums(sum_lines(observed)).o_c
    return errors


def observe_markers(
    angles: Floats, r: float, d: float, noise: float, random: np.random.Generator
) -> Floats:
    """Return rows [u₁ v₁ u₂ v₂] (n, 4) in px of a tool at `angles` (n,) in rad.

    Marker 1 is r px from the imaged RCM and marker 2 another d px. Each coordinate has Gaussian
    noise with the standard deviation `noise` (px).
    """
    n = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    exact = np.concatenate([r * n, (r + d) * n], axis=1)
    return exact + noise * random.standard_normal(exact.shape)


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    draws, H_values, tolerance = settings.draws, settings.H_values, settings.tolerance
    by_H, by_span = results["over-H"], results["over-span"]
    printed, refined = by_span["printed"], by_span["refined"]
    usual, narrow = (settings.span_values.index(x) for x in (settings.span, settings.judged_span))
    narrowest = printed["rms"][0]
    texts = Texts(bias=printed["bias"][usual], narrowest=narrowest, refined=refined["rms"][usual])
    yield Measurement(
        "lines-give-o_c",
        printed["rms"][usual],
        [0],
        trials=draws,
        bound=tolerance,
        confirmed=narrowest > tolerance,
        **texts,
    )
    slope, bias = fit_exponent(H_values, by_H["printed"]["rms"]), by_H["printed"]["bias"]
    bias_stays = bias[-1] > 0.7 * bias[H_values.index(settings.H)]
    texts = Texts(bias=bias[-1], lines=H_values[-1])
    yield Measurement("falls-as-average", slope, [0], trials=draws, confirmed=bias_stays, **texts)
    slope = fit_exponent(H_values, by_H["refined"]["rms"])
    yield Measurement("refined-falls", slope, [0], trials=draws)
    before, after = printed["bias"][narrow], refined["bias"][narrow]
    ratio, texts = abs(after / before), Texts(before=before, after=after)
    yield Measurement("no-bias", ratio, [0], trials=draws, confirmed=before > 10.0, **texts)


def fit_exponent(x: Sequence[float], y: Floats) -> float:
    """Return the exponent e of y ∝ x^e, by least squares on the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    panels = list[Panel]()
    for varied, label in VARIED_SETTINGS.items():
        x, curves, is_labelled = getattr(settings, f"{varied}_values"), list[Curve](), varied == "H"
        for style, (fit, name) in enumerate(FIT_NAMES.items()):
            rms_label, bias_label = (f"{name}: rms", f"{name}: |bias|") if is_labelled else ("", "")
            errors = results[f"over-{varied}"][fit]
            curves.append(make_curve(rms_label, x, errors["rms"], style))
            curves.append(make_curve(bias_label, x, np.abs(errors["bias"]), style, marks=True))
        error, limits = "error of $o_c$ [px]", (0.02, 500.0)
        panels.append(Panel(label, error, curves, log_x=True, log_y=True, y_limits=limits))
    yield PaperFigure("rcm-accuracy", [0], Figure("Accuracy of the imaged RCM", panels, columns=2))
