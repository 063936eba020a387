"""How well lines of the imaged tool tell where the RCM is seen: (16) as printed, our choice of
lines, our refinement.

A tool turns in the image about the imaged RCM, the origin here. Marker 1 is r px from it and marker
2 d px further, both with noise in u and v. A line through them has a normal that is wrong by an
angle of about √2 noise/d. That has two effects on (16): o_c scatters, and it is drawn towards the
tool, the more the less the lines differ in angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Experiment, Results, Shown, Task
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.imaged_rcm import ImagedRcm, follow, nearest_to_lines, solve

REFINEMENTS = ImagedRcm().refinements
MAX_CONDITION = ImagedRcm().max_condition
DEGREE = float(np.radians(1.0))
JUDGED_SPAN = 5.0 * DEGREE
"""rad over which the lines are spread where the bias is judged: narrow enough for (16) to have
one."""

WAYS = {"printed": "(16)", "refined": "(16), then our refinement"}
SLOW_WAYS = {
    "window": "last H lines, (16)",
    "window_refined": "last H lines, refined",
    "chosen": "chosen lines, (16)",
    "chosen_refined": "chosen lines, refined",
}


@dataclass(frozen=True)
class Lines:
    """What is known of the tool's lines: H of them, evenly over ``span`` rad of the image, ``r``,
    ``d``, ``noise`` px."""

    H: int = 50
    span: float = 10.0 * DEGREE
    r: float = 200.0
    d: float = 60.0
    noise: float = 0.3


@dataclass(frozen=True)
class Settings:
    """``typical`` is what is kept of the lines while H, the span (rad) or the noise (px) varies
    over ``draws``.

    The slow motion turns the imaged tool at ``speed`` rad/s for ``duration`` s, seen at
    ``frame_rate`` 1/s; it is judged from ``settled`` s on. An o_c is good enough within
    ``tolerance`` px, 5 % of the typical r.
    """

    typical: Lines = field(default_factory=Lines)
    numbers: tuple[int, ...] = (5, 10, 20, 50, 100, 200)
    spans: tuple[float, ...] = tuple(DEGREE * span for span in (1.0, 2.0, 5.0, 10.0, 20.0, 40.0))
    noises: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)
    draws: int = 1000
    seed: int = 0
    slow_seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    speed: float = DEGREE
    duration: float = 60.0
    settled: float = 10.0
    frame_rate: float = 60.0
    tolerance: float = 10.0


def tasks(settings: Settings) -> list[Task]:
    varied = {"H": settings.numbers, "span": settings.spans, "noise": settings.noises}
    accuracies = [
        Task(
            f"over-{name}",
            accuracy,
            {"settings": settings, "name": name, "values": values},
            cost=3.0,
        )
        for name, values in varied.items()
    ]
    slow = [
        Task(f"slow-{seed}", slow_motion, {"settings": settings, "seed": seed})
        for seed in settings.slow_seeds
    ]
    return accuracies + slow


def accuracy(
    folder: Path, settings: Settings, name: str, values: Sequence[float]
) -> dict[str, Any]:
    """Error of o_c over values of one field of the lines: rms px, and bias px towards the tool,
    either way."""
    del folder
    points = [replace(settings.typical, **{name: value}) for value in values]
    errors: list[Floats] = [
        np.array(sample(lines, settings.draws, settings.seed)) for lines in points
    ]
    return {
        "values": list(values),
        **{
            way: {
                "rms": [rms(np.linalg.norm(error[:, i], axis=1)) for error in errors],
                "bias": [float(np.mean(error[:, i, 0])) for error in errors],
            }
            for i, way in enumerate(WAYS)
        },
    }


def rms(errors: Any) -> float:
    """Root of the mean square."""
    squares: Floats = np.asarray(errors, dtype=float) ** 2
    return float(np.sqrt(squares.mean()))


def sample(lines: Lines, draws: int, seed: int) -> list[list[Floats]]:
    """Errors of o_c by (16) and refined, each [towards the tool, across] px, of as many draws."""
    random = np.random.default_rng(seed)
    errors: list[list[Floats]] = []
    for _ in range(draws):
        middle = random.uniform(-np.pi, np.pi)
        seen = markers(lines, middle + np.linspace(-0.5, 0.5, lines.H) * lines.span, random)
        c, s = np.cos(middle), np.sin(middle)
        aligned = np.array([[c, s], [-s, c]])
        found = nearest_to_lines(seen, lines.H)[0], solve(seen, lines.H, REFINEMENTS)[0]
        errors.append([aligned @ o_c for o_c in found])
    return errors


def markers(lines: Lines, angles: Floats, random: np.random.Generator) -> Floats:
    """Rows [u₁ v₁ u₂ v₂] px of a tool seen at these angles (n,) rad, with noise."""
    n = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    exact = np.concatenate([lines.r * n, (lines.r + lines.d) * n], axis=1)
    return exact + lines.noise * random.standard_normal(exact.shape)


def slow_motion(folder: Path, settings: Settings, seed: int) -> dict[str, Any]:
    """Error px of o_c in every frame of a slow turn: the last H lines as they come, and lines
    chosen by leverage.

    ``gate`` is the error of our way in the first frame that its gate on the condition of (16) lets
    pass.
    """
    del folder
    H = settings.typical.H
    time = np.arange(round(settings.duration * settings.frame_rate)) / settings.frame_rate
    seen = markers(settings.typical, settings.speed * time, np.random.default_rng(seed))
    kept, count = ImagedRcm(lines=H).init()
    errors: dict[str, list[float]] = {way: [] for way in SLOW_WAYS}
    gate = np.nan
    for i in range(len(time)):
        window = seen[max(i + 1 - H, 0) : i + 1]
        kept, count, refined, condition = follow(kept, count, seen[i].reshape(2, 2), REFINEMENTS)
        found = {
            "window": nearest_to_lines(window, len(window))[0],
            "window_refined": solve(window, len(window), REFINEMENTS)[0],
            "chosen": nearest_to_lines(kept, count)[0],
            "chosen_refined": refined,
        }
        for way, o_c in found.items():
            errors[way].append(float(np.linalg.norm(o_c)))
        if np.isnan(gate) and condition <= MAX_CONDITION:
            gate = errors["chosen_refined"][-1]
    return {"time": time.tolist(), "errors": errors, "gate": gate}


def chapter(settings: Settings, results: Results) -> Chapter:
    return Chapter(
        [*_accuracy_claims(settings, results), *_slow_claims(settings, results)],
        [_accuracy_figure(settings, results), _slow_figure(settings, results)],
    )


def _accuracy_claims(settings: Settings, results: Results) -> list[Claim]:
    lines, seeds = settings.typical, [settings.seed]
    over_H, over_span = results["over-H"].values, results["over-span"].values
    at, narrow = settings.spans.index(lines.span), settings.spans.index(JUDGED_SPAN)
    error, bias = over_span["printed"]["rms"], over_span["printed"]["bias"]
    refined_error, refined_bias = over_span["refined"]["rms"], over_span["refined"]["bias"]
    far = over_H["printed"]["bias"][-1]
    return [
        Claim(
            f"H = {lines.H} old lines give the imaged RCM",
            "III-A, (16)",
            error[at],
            "px",
            "<=",
            settings.tolerance,
            seeds,
            remark=f"true of lines spread over {lines.span / DEGREE:g}°; {bias[at]:.1f} px of it "
            f"is bias towards the "
            f"tool, and at {settings.spans[0] / DEGREE:g}° the error is {error[0]:.0f} px",
            detail=f"rms of {settings.draws} draws with r = {lines.r:g} px, d = {lines.d:g} px, "
            f"{lines.noise:g} px of "
            f"noise; refined {refined_error[at]:.1f} px",
            figure="rcm-accuracy",
            trap="T8",
            confirmed=error[0] > settings.tolerance,
        ),
        Claim(
            "the error of (16) falls with the number of lines as an average's does, with H to "
            "the power −0.5",
            "III-A, (16)",
            slope(over_H["values"], over_H["printed"]["rms"]),
            "exponent",
            "<=",
            -0.4,
            seeds,
            remark=f"its bias does not fall: {far:.1f} px with {settings.numbers[-1]} lines",
            figure="rcm-accuracy",
            trap="T8",
            confirmed=far > 0.7 * over_H["printed"]["bias"][settings.numbers.index(lines.H)],
        ),
        Claim(
            "the error after our refinement falls with the number of lines as an average's does",
            "ours",
            slope(over_H["values"], over_H["refined"]["rms"]),
            "exponent",
            "<=",
            -0.4,
            seeds,
            figure="rcm-accuracy",
        ),
        Claim(
            f"our refinement takes away the bias of (16), at a span of {JUDGED_SPAN / DEGREE:g}°",
            "ours",
            abs(refined_bias[narrow] / bias[narrow]),
            "share left",
            "<=",
            0.1,
            seeds,
            detail=f"bias {bias[narrow]:.1f} px before, {refined_bias[narrow]:.1f} px after",
            figure="rcm-accuracy",
            trap="T8",
            confirmed=bias[narrow] > 10.0,
        ),
    ]


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """The exponent of y ∝ x^exponent, by least squares of the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _slow_claims(settings: Settings, results: Results) -> list[Claim]:
    seeds, H, speed = list(settings.slow_seeds), settings.typical.H, settings.speed / DEGREE
    late = {way: settled_rms(settings, results, way) for way in SLOW_WAYS}
    gates = [results[f"slow-{seed}"].values["gate"] for seed in seeds]
    even = results["over-span"].values["refined"]["rms"][
        settings.spans.index(settings.typical.span)
    ]
    outward = early_rms(settings, results, "chosen_refined")
    when = f"rms from {settings.settled:g} s on"
    return [
        Claim(
            f"the last H = {H} lines give the imaged RCM while the imaged tool turns at "
            f"{speed:g}°/s",
            "III-A, (16)",
            late["window"],
            "px",
            "<=",
            settings.tolerance,
            seeds,
            remark=f"{H} frames at {settings.frame_rate:g} frames/s span "
            f"{H / settings.frame_rate * speed:.2f}°, about "
            f"the noise of one line's angle: o_c collapses onto the tool, which is "
            f"{settings.typical.r:g} px away",
            detail=f"{when}; refining such lines gives {late['window_refined']:.0f} px",
            figure="rcm-slow",
            trap="T8",
            confirmed=late["window"] > 0.5 * settings.typical.r,
        ),
        Claim(
            f"{H} lines chosen by what they say of o_c give the imaged RCM in the same motion, "
            f"by (16)",
            "ours",
            late["chosen"],
            "px",
            "<=",
            settings.tolerance,
            seeds,
            detail=when,
            figure="rcm-slow",
        ),
        Claim(
            f"{H} chosen lines and our refinement give the imaged RCM in the same motion",
            "ours",
            late["chosen_refined"],
            "px",
            "<=",
            settings.tolerance,
            seeds,
            remark=f"a line that noise turned outwards has more leverage and stays: when the "
            f"tool has turned by "
            f"{settings.typical.span / DEGREE:g}° the error is {outward:.0f} px, where {H} lines "
            f"evenly "
            f"spread over as much give {even:.1f} px",
            detail=f"{when}; in the first frame that our gate lets pass (condition of (16) at most "
            f"{MAX_CONDITION:g}) the error is {min(gates):.0f} to {max(gates):.0f} px: noise "
            f"alone passes that gate, "
            "so that exploration has to see to the span",
            figure="rcm-slow",
        ),
    ]


def settled_rms(settings: Settings, results: Results, way: str) -> float:
    """Error px of one way in the slow motion, rms over all seeds and the frames from ``settled`` s
    on."""
    first = round(settings.settled * settings.frame_rate)
    errors = [results[f"slow-{seed}"].values["errors"][way][first:] for seed in settings.slow_seeds]
    return rms(errors)


def early_rms(settings: Settings, results: Results, way: str) -> float:
    """Error px of one way when the tool has turned by the typical span, rms over all seeds."""
    frame = round(settings.typical.span / settings.speed * settings.frame_rate)
    errors = [results[f"slow-{seed}"].values["errors"][way][frame] for seed in settings.slow_seeds]
    return rms(errors)


def _accuracy_figure(settings: Settings, results: Results) -> Shown:
    axes = {
        "H": ("number of lines H", 1.0),
        "span": ("span of the lines' angles [°]", 1.0 / DEGREE),
        "noise": ("noise of the markers [px]", 1.0),
    }
    panels = [
        Panel(
            label,
            "error of $o_c$ [px]",
            _errors(results[f"over-{name}"].values, unit, labelled=i == 0),
            log_x=True,
            log_y=True,
            y_limits=(0.02, 500.0),
        )
        for i, (name, (label, unit)) in enumerate(axes.items())
    ]
    lines = settings.typical
    caption = (
        f"Error of the imaged RCM, rms of {settings.draws} draws, and the size of its bias. "
        f"Where nothing else is "
        f"said H = {lines.H}, span {lines.span / DEGREE:g}°, r = {lines.r:g} px, d = {lines.d:g} "
        f"px and "
        f"{lines.noise:g} px of noise. The bias of (16) is towards the tool. The legend holds "
        f"for all three panels."
    )
    figure = Figure("Accuracy of the imaged RCM", panels, columns=2)
    return Shown("rcm-accuracy", "III-A", caption, [settings.seed], figure)


def _errors(values: dict[str, Any], unit: float, labelled: bool) -> list[Curve]:
    x = np.array(values["values"]) * unit
    curves: list[Curve] = []
    for style, (way, label) in enumerate(WAYS.items()):
        labels = [f"{label}: {what}" if labelled else "" for what in ("rms", "|bias|")]
        curves.append(curve(labels[0], x, values[way]["rms"], style))
        curves.append(curve(labels[1], x, np.abs(values[way]["bias"]), style, marks=True))
    return curves


def _slow_figure(settings: Settings, results: Results) -> Shown:
    runs = [results[f"slow-{seed}"].values for seed in settings.slow_seeds]
    curves = [
        curve(
            label,
            runs[0]["time"][1:],
            np.median([run["errors"][way] for run in runs], axis=0)[1:],
            style,
        )
        for style, (way, label) in enumerate(SLOW_WAYS.items())
    ]
    panel = Panel("time [s]", "error of $o_c$ [px]", curves, log_y=True)
    caption = (
        f"Error of the imaged RCM while the imaged tool turns at {settings.speed / DEGREE:g}°/s, "
        f"H = "
        f"{settings.typical.H}, {settings.typical.noise:g} px of noise at "
        f"{settings.frame_rate:g} frames/s, median of "
        f"{len(runs)} seeds. The tool is {settings.typical.r:g} px away. Chosen lines are those "
        f"with the most leverage."
    )
    return Shown(
        "rcm-slow",
        "III-A",
        caption,
        list(settings.slow_seeds),
        Figure("The imaged RCM in slow motion", [panel]),
    )


EXPERIMENT = Experiment(
    name="imaged-rcm",
    title="The imaged RCM",
    about="Eq. (16): its error over the number of lines, their span and the noise, and how a "
    "slow motion defeats it.",
    whole=Settings(),
    quick=Settings(draws=200, slow_seeds=(0,)),
    tasks=tasks,
    chapter=chapter,
)
