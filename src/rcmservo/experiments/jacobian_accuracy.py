"""Which estimator has the more accurate Jacobian: IV-B's comparison, made fair.

The truth judges Ĵ at every frame twice: as a matrix, ‖Ĵ − J‖/‖J‖, and only along the present motion
v, ‖(Ĵ − J)v‖/‖Jv‖, which is all that the flow rule (28) sees. The printed Γ is judged in real time,
and given 10⁴ s of its own time at every frame, on random observations as the paper has it and on
those chosen by leverage, as our estimators do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.closed_loop import NOISE
from rcmservo.experiments.harness.lab.streams import (
    ESTIMATORS,
    LABELS,
    NAMES,
    SHORT,
    Kind,
    Stream,
    StreamSettings,
    learnt,
    stream,
)
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.statistics import median
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.interfaces import Floats

PHASES: dict[Kind, tuple[str, ...]] = {
    "servo": ("exploring", "saturated way", "end"),
    "tour": ("learning", "touring"),
}
JUDGED = 1
"""The phase of either kind of stream that the claims are about."""

AGAINST = ("random", "given time", "real time")
STREAMS: dict[Kind, str] = {"servo": "servo run", "tour": "fast tour"}
MEASURES = {
    "full": "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
    "along": "$\\|(\\hat{J} - J)v\\| / \\|Jv\\|$ [1]",
}
WORDS = {"full": "whole matrix", "along": "along the motion"}
LIMITS = (1e-5, 20.0)
"""Of the errors' axes, with room for the legend below the curves."""

NOTHING = 0.9
"""Error of Ĵ from which on it is no better than none."""

POINTS = 300
"""Medians over time that a series keeps for its figure."""


@dataclass(frozen=True)
class Settings:
    """Streams of several seeds at several noises."""

    seeds: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 6, 7)
    """Of the scenes, one stream of each kind in each at every noise."""
    noises: tuple[float, ...] = (NOISE, 0.3)
    """px; the first one is judged."""
    least_speed: float = 0.3
    """mm/s from which on there is a direction of motion."""
    streams: StreamSettings = field(default_factory=StreamSettings)
    """What the servo does while its samples are taken."""


@dataclass(frozen=True)
class Errors:
    """One error of one estimator on one stream."""

    phases: JsonFloats
    """Median in every phase."""
    series: JsonFloats
    """Medians over pieces of the time."""


@dataclass(frozen=True)
class Compared:
    """Every estimator's errors on one stream."""

    time: JsonFloats
    """s, the median of each piece of the series."""
    errors: dict[str, dict[str, Errors]]
    """By the names in ESTIMATORS, then by those in MEASURES."""


def tasks(settings: Settings) -> list[Task]:
    kinds: dict[Kind, float] = {"servo": 4.0, "tour": 2.0}
    return [
        Task(
            f"{kind}-{seed}-{noise:g}",
            partial(compare, settings=settings, kind=kind, seed=seed, noise=noise),
            cost,
        )
        for kind, cost in kinds.items()
        for seed in settings.seeds
        for noise in settings.noises
    ]


def compare(folder: Path, settings: Settings, kind: Kind, seed: int, noise: float) -> Compared:
    """One stream through every estimator."""
    del folder
    rig, seen = stream(seed, noise, settings.streams, kind)
    errors: dict[str, dict[str, Errors]] = {}
    for name, estimator in ESTIMATORS.items():
        J_hat, _ = learnt(estimator, seen.samples, rig.settings.tool)
        errors[name] = {
            measure: Errors(by_phase(error, seen.phase, len(PHASES[kind])), over_time(error))
            for measure, error in judged(J_hat, seen, settings.least_speed).items()
        }
    return Compared(over_time(seen.time), errors)


def judged(J_hat: Floats, seen: Stream, least_speed: float) -> dict[str, Floats]:
    """Both errors (n,) of Ĵ (n, 3, 3); along the motion NaN where the arm stands."""
    wrong = J_hat - seen.J
    full = np.linalg.norm(wrong, axis=(1, 2)) / np.linalg.norm(seen.J, axis=(1, 2))
    flow, missing = (
        np.linalg.norm((matrix @ seen.v[:, :, None])[:, :, 0], axis=1) for matrix in (seen.J, wrong)
    )
    moves = np.linalg.norm(seen.v, axis=1) > least_speed
    return {"full": full, "along": np.where(moves, missing / np.maximum(flow, 1e-12), np.nan)}


def by_phase(error: Floats, phase: Floats, phases: int) -> Floats:
    """Median of an error (n,) in every phase; NaN where a phase has no number."""
    return np.array([finite_median(error[phase == i]) for i in range(phases)])


def over_time(numbers: Floats) -> Floats:
    """POINTS medians of successive numbers."""
    pieces = np.array_split(numbers, min(POINTS, len(numbers)))
    return np.array([finite_median(piece) for piece in pieces])


def finite_median(numbers: Floats) -> float:
    """Median of those that are finite, or NaN."""
    return median(numbers[np.isfinite(numbers)])


@dataclass(frozen=True)
class AccuracyTable:
    """All results, and how to ask them."""

    settings: Settings
    """Which seeds and noises there are."""
    results: Results
    """One Compared for every kind of stream, seed and noise."""

    def of(self, kind: Kind, seed: int, noise: float) -> Compared:
        return self.results.of(Compared, f"{kind}-{seed}-{noise:g}")

    def errors(self, kind: Kind, noise: float, name: str, measure: str, phase: int) -> Floats:
        """The median error in a phase, for every seed."""
        compared = [self.of(kind, seed, noise) for seed in self.settings.seeds]
        return np.array([one.errors[name][measure].phases[phase] for one in compared])

    def error(self, kind: Kind, noise: float, name: str, measure: str) -> float:
        """Median over the seeds in the phase that is judged."""
        return finite_median(self.errors(kind, noise, name, measure, JUDGED))

    def ratio(self, kind: Kind, noise: float, measure: str, against: str) -> float:
        """Median over seeds of flow's error over another's."""
        flow, other = (
            self.errors(kind, noise, name, measure, JUDGED) for name in ("flow", against)
        )
        return finite_median(flow / other)


def chapter(settings: Settings, results: Results) -> Chapter:
    table = AccuracyTable(settings, results)
    claims = [
        more_accurate(table, kind, measure, against)
        for against in AGAINST
        for kind in STREAMS
        for measure in MEASURES
    ]
    figures = [
        _over_time(table, "servo"),
        _over_time(table, "tour"),
        _per_seed(table),
        _phases(table),
    ]
    return Chapter(claims, figures)


def more_accurate(table: AccuracyTable, kind: Kind, measure: str, against: str) -> Claim:
    """Flow's claim of the more accurate Jacobian, on one kind of stream and by one measure."""
    noise = table.settings.noises[0]
    return Claim(
        "flow's error of Ĵ over that of the projection-based method is at most 1",
        "more-accurate",
        table.ratio(kind, noise, measure, against),
        "x the error",
        "<=",
        1.0,
        table.settings.seeds,
        case=(LABELS[against], f"{STREAMS[kind]}, {WORDS[measure]}"),
        remark=_how_good(table, kind, measure, against),
        detail=_all_errors(table, kind, measure),
        figure="accuracy-seeds",
    )


def _all_errors(table: AccuracyTable, kind: Kind, measure: str) -> str:
    noise = table.settings.noises[0]
    medians = [
        f"{LABELS[name]} {table.error(kind, noise, name, measure):.3f}" for name in ESTIMATORS
    ]
    return f"median errors, {PHASES[kind][JUDGED]}: {'; '.join(medians)}"


def _how_good(table: AccuracyTable, kind: Kind, measure: str, against: str) -> str:
    """What a reader must know beside a ratio: against what it holds, and how good it is then."""
    noise = table.settings.noises[0]
    flow, other = (table.error(kind, noise, name, measure) for name in ("flow", against))
    words = f"flow's error is {flow:.2g}, the projection-based one {other:.2g}"
    if other > NOTHING:
        words += ", about that of Ĵ = 0, which is 1"
    ratios = {n: table.ratio(kind, n, measure, against) for n in table.settings.noises}
    turned = [n for n, ratio in ratios.items() if (ratio <= 1.0) != (ratios[noise] <= 1.0)]
    others = ", ".join(f"{n:g} px of noise ({ratios[n]:.2g})" for n in turned)
    return f"{words}; it is the other way round with {others}" if turned else words


def _over_time(table: AccuracyTable, kind: Kind) -> Shown:
    seed, noise = table.settings.seeds[0], table.settings.noises[0]
    compared = table.of(kind, seed, noise)

    def curves(measure: str) -> list[Curve]:
        return [
            curve(
                SHORT[style] if measure == "full" else "",
                compared.time,
                compared.errors[name][measure].series,
                style,
            )
            for style, name in enumerate(ESTIMATORS)
        ]

    panels = [
        Panel("time [s]", label, curves(measure), log_y=True, y_limits=LIMITS)
        for measure, label in MEASURES.items()
    ]
    caption = (
        "Error of Ĵ against the truth, scaled, every estimator on the same samples: of the whole "
        "matrix on the left, along the present motion on the right (only where marker 1 moves by "
        f"more than {table.settings.least_speed:g} mm/s). Medians over pieces of "
        f"{compared.time[-1] / POINTS:.1g} s. {NAMES}"
    )
    title = f"Every estimator in a {STREAMS[kind]}, seed {seed}, {noise:g} px of noise"
    return Shown(f"accuracy-{kind}", "IV-B", caption, [seed], Figure(title, panels, columns=2))


def seed_marks(label: str, groups: Sequence[Floats], style: int) -> Curve:
    """One mark for each seed, beside the place of its group."""
    x = [
        place + 0.22 * style + 0.02 * i - 0.18
        for place, group in enumerate(groups)
        for i in range(len(group))
    ]
    return curve(label, x, np.concatenate(groups), style, marks=True)


def _per_seed(table: AccuracyTable) -> Shown:
    settings = table.settings

    def curves(kind: Kind, measure: str) -> list[Curve]:
        return [
            seed_marks(
                f"{noise:g} px of noise",
                [table.errors(kind, noise, name, measure, JUDGED) for name in ESTIMATORS],
                style,
            )
            for style, noise in enumerate(settings.noises)
        ]

    panels = [
        Panel(
            "",
            f"{label}\n{PHASES[kind][JUDGED]}",
            curves(kind, measure),
            log_y=True,
            categories=SHORT,
        )
        for kind in STREAMS
        for measure, label in MEASURES.items()
    ]
    caption = (
        "Median error of Ĵ of every seed: while a servo run is saturated (above), and while "
        f"touring after the first {settings.streams.learning:g} s (below). {NAMES}"
    )
    figure = Figure("Accuracy by seed", panels, columns=2)
    return Shown("accuracy-seeds", "IV-B", caption, settings.seeds, figure)


def _phases(table: AccuracyTable) -> Shown:
    noise, phases = table.settings.noises[0], PHASES["servo"]

    def middles(name: str, measure: str) -> list[float]:
        errors = [table.errors("servo", noise, name, measure, i) for i in range(len(phases))]
        return [finite_median(one) for one in errors]

    def curves(measure: str) -> list[Curve]:
        return [
            curve(
                SHORT[style] if measure == "full" else "",
                range(len(phases)),
                middles(name, measure),
                style,
                marks=True,
            )
            for style, name in enumerate(ESTIMATORS)
        ]

    panels = [
        Panel("", label, curves(measure), log_y=True, y_limits=LIMITS, categories=list(phases))
        for measure, label in MEASURES.items()
    ]
    caption = f"Medians over the seeds in every phase of the servo runs. {NAMES}"
    figure = Figure("Accuracy by phase", panels, columns=2)
    return Shown("accuracy-phases", "IV-B", caption, table.settings.seeds, figure)


EXPERIMENT = Experiment(
    name="jacobian-accuracy",
    title="Accuracy of the estimated Jacobian",
    about="The comparison of both estimators in IV-B: the same samples through every estimator, "
    "judged by the truth.",
    whole=Settings(),
    quick=Settings(
        seeds=(0,),
        noises=(NOISE,),
        streams=StreamSettings(duration=40.0, touring=25.0, learning=15.0),
    ),
    tasks=tasks,
    chapter=chapter,
)
