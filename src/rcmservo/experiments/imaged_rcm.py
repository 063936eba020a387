"""How well lines of the imaged tool tell where the RCM is seen: (16) as printed, and our
refinement.

A tool turns in the image about the imaged RCM, the origin here. Marker 1 is r px from it and marker
2 d px further, both with noise in u and v. A line through them has a normal that is wrong by an
angle of about √2 noise/d. That has two effects on (16): o_c scatters, and it is drawn towards the
tool, the more the less the lines differ in angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.lines import DEGREE, REFINEMENTS, Lines, markers
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import rms
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.imaged_rcm import nearest_to_lines, solve

JUDGED_SPAN = 5.0 * DEGREE
"""rad over which the lines are spread where the bias is judged: narrow enough for (16) to have
one."""


@dataclass(frozen=True)
class Settings:
    """The lines while their number, their span or the noise varies."""

    typical: Lines = field(default_factory=Lines)
    """What is kept while one of them varies."""
    numbers: tuple[int, ...] = (5, 10, 20, 50, 100, 200)
    """H."""
    spans: tuple[float, ...] = tuple(DEGREE * span for span in (1.0, 2.0, 5.0, 10.0, 20.0, 40.0))
    """rad."""
    noises: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)
    """px."""
    draws: int = 1000
    """Sets of lines over which every error is taken."""
    seed: int = 0
    """Of the draws, the same for every value."""
    tolerance: float = 10.0
    """px within which o_c is good enough, 5 % of the typical r."""


@dataclass(frozen=True)
class RcmErrors:
    """The errors of one way to solve for o_c, over values of one field of the lines."""

    rms: JsonFloats
    """px."""
    bias: JsonFloats
    """px towards the tool."""


@dataclass(frozen=True)
class Accuracy:
    """The errors of both ways while one field of the lines varies."""

    values: JsonFloats
    """Of that field (n,): H, a span in rad, or noise in px."""
    printed: RcmErrors
    """By (16) as printed."""
    refined: RcmErrors
    """By (16), then our refinement."""


def tasks(settings: Settings) -> list[Task]:
    varied: dict[str, Sequence[float]] = {
        "H": settings.numbers,
        "span": settings.spans,
        "noise": settings.noises,
    }
    return [
        Task(f"over-{name}", partial(accuracy, settings=settings, name=name, values=some), cost=3.0)
        for name, some in varied.items()
    ]


def accuracy(folder: Path, settings: Settings, name: str, values: Sequence[float]) -> Accuracy:
    """Error of o_c over values of one field of the lines."""
    del folder
    points = [replace(settings.typical, **{name: value}) for value in values]
    samples = [sample(lines, settings.draws, settings.seed) for lines in points]

    def way(i: int) -> RcmErrors:
        errors = [sample[:, i] for sample in samples]
        return RcmErrors(
            rms=np.array([rms(np.linalg.norm(error, axis=1)) for error in errors]),
            bias=np.array([float(np.mean(error[:, 0])) for error in errors]),
        )

    return Accuracy(np.array(values, dtype=float), way(0), way(1))


def sample(lines: Lines, draws: int, seed: int) -> Floats:
    """Errors of o_c by (16) as printed and refined, each [towards the tool, across] px, of as many
    draws: (draws, 2, 2)."""
    random = np.random.default_rng(seed)
    errors = np.empty((draws, 2, 2))
    for error in errors:
        middle = random.uniform(-np.pi, np.pi)
        seen = markers(lines, middle + np.linspace(-0.5, 0.5, lines.H) * lines.span, random)
        c, s = np.cos(middle), np.sin(middle)
        aligned = np.array([[c, s], [-s, c]])
        error[0] = aligned @ nearest_to_lines(seen, lines.H, True)[0]
        error[1] = aligned @ solve(seen, lines.H, REFINEMENTS, False)[0]
    return errors


@dataclass(frozen=True)
class Accuracies:
    """All accuracies, and how to ask them."""

    settings: Settings
    """Which values there are, and which are typical."""
    H: Accuracy
    """While the number of lines varies."""
    span: Accuracy
    """While their span varies."""
    noise: Accuracy
    """While the noise varies."""

    @property
    def usual(self) -> int:
        """The place of the typical span."""
        return self.settings.spans.index(self.settings.typical.span)

    @property
    def narrow(self) -> int:
        """The place of the span at which the bias is judged."""
        return self.settings.spans.index(JUDGED_SPAN)


def chapter(settings: Settings, results: Results) -> Chapter:
    found = Accuracies(
        settings, *(results.of(Accuracy, f"over-{name}") for name in ("H", "span", "noise"))
    )
    claims = [
        lines_give_o_c(found),
        falls_as_an_average(found),
        refined_falls_too(found),
        refinement_takes_bias_away(found),
    ]
    return Chapter(claims, [_figure(found)])


def lines_give_o_c(found: Accuracies) -> Claim:
    settings, lines, printed = found.settings, found.settings.typical, found.span.printed
    return Claim(
        f"(16) as printed on H = {lines.H} lines spread over {lines.span / DEGREE:g}° gives the "
        "imaged RCM: rms error",
        "imaged-rcm",
        float(printed.rms[found.usual]),
        "px",
        "<=",
        settings.tolerance,
        [settings.seed],
        trials=settings.draws,
        remark=f"{printed.bias[found.usual]:.1f} px of it is bias towards the tool, and at "
        f"{settings.spans[0] / DEGREE:g}° the error is {printed.rms[0]:.0f} px",
        detail=f"{settings.draws} draws with r = {lines.r:g} px, d = {lines.d:g} px, "
        f"{lines.noise:g} px of noise; refined {found.span.refined.rms[found.usual]:.1f} px",
        figure="rcm-accuracy",
        trap="T8",
        confirmed=bool(printed.rms[0] > settings.tolerance),
    )


def falls_as_an_average(found: Accuracies) -> Claim:
    settings, printed = found.settings, found.H.printed
    far, here = printed.bias[-1], printed.bias[settings.numbers.index(settings.typical.H)]
    return Claim(
        "the error of (16) falls with the number of lines as an average's does, with H to the "
        "power −0.5: exponent",
        "imaged-rcm",
        slope(found.H.values, printed.rms),
        "",
        "<=",
        -0.4,
        [settings.seed],
        follows=True,
        trials=settings.draws,
        remark=f"its bias does not fall: {far:.1f} px with {settings.numbers[-1]} lines",
        figure="rcm-accuracy",
        trap="T8",
        confirmed=bool(far > 0.7 * here),
    )


def refined_falls_too(found: Accuracies) -> Claim:
    return Claim(
        "the error after our refinement falls with the number of lines as an average's does: "
        "exponent",
        OURS,
        slope(found.H.values, found.H.refined.rms),
        "",
        "<=",
        -0.4,
        [found.settings.seed],
        trials=found.settings.draws,
        figure="rcm-accuracy",
    )


def refinement_takes_bias_away(found: Accuracies) -> Claim:
    before, after = (way.bias[found.narrow] for way in (found.span.printed, found.span.refined))
    return Claim(
        f"our refinement takes away the bias of (16), at a span of {JUDGED_SPAN / DEGREE:g}°",
        OURS,
        float(abs(after / before)),
        "of it left",
        "<=",
        0.1,
        [found.settings.seed],
        trials=found.settings.draws,
        detail=f"bias {before:.1f} px before, {after:.1f} px after",
        figure="rcm-accuracy",
        trap="T8",
        confirmed=bool(before > 10.0),
    )


def slope(x: Floats, y: Floats) -> float:
    """The exponent of y ∝ x^exponent, by least squares of the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _figure(found: Accuracies) -> Shown:
    settings, lines = found.settings, found.settings.typical
    panels = [
        _panel("number of lines H", found.H, 1.0, labelled=True),
        _panel("span of the lines' angles [°]", found.span, 1.0 / DEGREE),
        _panel("noise of the markers [px]", found.noise, 1.0),
    ]
    caption = (
        f"Error of the imaged RCM, rms of {settings.draws} draws, and the size of its bias. Where "
        f"nothing else is said H = {lines.H}, span {lines.span / DEGREE:g}°, r = {lines.r:g} px, d "
        f"= {lines.d:g} px and {lines.noise:g} px of noise. The bias of (16) is towards the tool. "
        "The legend holds for all three panels."
    )
    figure = Figure("Accuracy of the imaged RCM", panels, columns=2)
    return Shown("rcm-accuracy", "III-A", caption, [settings.seed], figure)


def _panel(label: str, over: Accuracy, unit: float, labelled: bool = False) -> Panel:
    x = over.values * unit
    curves = list[Curve]()
    ways = {"(16)": over.printed, "(16), then our refinement": over.refined}
    for style, (name, way) in enumerate(ways.items()):
        curves.append(curve(f"{name}: rms" if labelled else "", x, way.rms, style))
        label_bias = f"{name}: |bias|" if labelled else ""
        curves.append(curve(label_bias, x, np.abs(way.bias), style, marks=True))
    limits = (0.02, 500.0)
    return Panel(label, "error of $o_c$ [px]", curves, log_x=True, log_y=True, y_limits=limits)


EXPERIMENT = Experiment(
    name="imaged-rcm",
    title="The imaged RCM",
    about="Eq. (16) as printed: its error over the number of lines, their span and the noise.",
    whole=Settings(),
    quick=Settings(draws=200),
    tasks=tasks,
    chapter=chapter,
)
