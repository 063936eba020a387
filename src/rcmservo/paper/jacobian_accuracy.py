"""Experiment `jacobian-accuracy`: the comparison of both estimators in IV-B, on equal terms.

Two errors of Ĵ are computed at each frame: of the whole matrix, ‖Ĵ − J‖/‖J‖, and along the present
motion v, ‖(Ĵ − J)v‖/‖Jv‖, the only direction that the flow rule (28) observes. The printed Γ is
tested in real time and with 10⁴ s of estimator time per frame, on random observations as in the
paper, and on observations selected by leverage as in the built-in estimators.
"""

from collections.abc import Iterator
from functools import partial

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.paper.camera_knowledge import tasks as servo_tasks
from rcmservo.paper.lab.closed_loop import FLOW_EXPLORATION, PAPER_SCENES
from rcmservo.paper.lab.knowledge import PHASES as SERVO_PHASES
from rcmservo.paper.lab.streams import (
    ESTIMATOR_NAMES,
    ESTIMATORS,
    SERIES_LENGTH,
    SHORT_NAMES,
    SHORT_NAMES_NOTE,
    Kind,
    jacobian_errors,
    median_series,
    run_estimator,
    stream,
    summarise_error,
)
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, finite, median, seed_marks

PHASES: dict[Kind, tuple[str, ...]] = {
    "servo": SERVO_PHASES,
    "tour": ("initial exploration", "later exploration"),
}
JUDGED = 1
"""Index of the phase, in both kinds of stream, that the claims concern."""
COMPARED_ESTIMATORS = ("random", "given time", "real time")
STREAMS: dict[Kind, str] = {"servo": "servo run", "tour": "fast exploration"}
MEASURES = {
    "full": "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
    "along": "$\\|(\\hat{J} - J)v\\| / \\|Jv\\|$ [1]",
}
MEASURE_NAMES = {"full": "whole matrix", "along": "along the motion"}
ERROR_AXIS = (1e-5, 20.0)
"""Limits of the error axes, with space for the legend below the curves."""
USELESS_ERROR = 0.9
"""Relative error of Ĵ from which on Ĵ is no better than 0."""


def fixed_settings() -> dict[str, object]:
    return {"estimators": ESTIMATORS, "scene": PAPER_SCENES, "exploration": FLOW_EXPLORATION}


def tasks(settings: Settings) -> list[Task]:
    """Return the servo runs, shared with `camera-knowledge`, and the explorations."""
    tours = [
        Task(
            f"tour-{seed}-{noise:g}", partial(tour, settings=settings, seed=seed, noise=noise), 2.0
        )
        for seed in range(settings.seeds)
        for noise in settings.noises
    ]
    return [*servo_tasks(settings), *tours]


def tour(settings: Settings, seed: int, noise: float) -> TaskResult:
    """Run each estimator on the samples of one exploration; return the errors of Ĵ."""
    rig, recorded = stream(seed, noise, settings, "tour")
    errors: dict[str, TaskResult] = {}
    for name, estimator in ESTIMATORS.items():
        J_hat, _memory = run_estimator(estimator, recorded.samples, rig.settings.tool)
        errors[name] = {
            measure: summarise_error(error, recorded.phase, len(PHASES["tour"]))
            for measure, error in jacobian_errors(J_hat, recorded, settings.least_speed).items()
        }
    return {"time": median_series(recorded.time), "errors": errors}


class AccuracyTable:
    """Errors of Ĵ by kind of stream, noise, estimator and measure."""

    def __init__(self, settings: Settings, results: Results) -> None:
        self.settings, self.results = settings, results

    def of_seeds(
        self, kind: Kind, noise: float, name: str, measure: str, phase: int = JUDGED
    ) -> Floats:
        """Return the median error in a phase, for each seed."""
        runs = [self.results[f"{kind}-{i}-{noise:g}"] for i in range(self.settings.seeds)]
        return column(runs, "errors", name, measure, "phases")[:, phase]

    def median(
        self, kind: Kind, noise: float, name: str, measure: str, phase: int = JUDGED
    ) -> float:
        """Return the median over the seeds."""
        return median(finite(self.of_seeds(kind, noise, name, measure, phase)))

    def ratio(self, kind: Kind, noise: float, measure: str, against: str) -> float:
        """Return the median over the seeds of the flow rule's error over another estimator's."""
        flow, other = (self.of_seeds(kind, noise, name, measure) for name in ("flow", against))
        return median(finite(flow / other))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    table, noise = AccuracyTable(settings, results), settings.noises[0]
    for against in COMPARED_ESTIMATORS:
        for kind, words in STREAMS.items():
            for one in MEASURES:
                medians = {name: table.median(kind, noise, name, one) for name in ESTIMATORS}
                yield Measurement(
                    "more-accurate",
                    table.ratio(kind, noise, one, against),
                    range(settings.seeds),
                    case=(ESTIMATOR_NAMES[against], f"{words}, {MEASURE_NAMES[one]}"),
                    flow=medians["flow"],
                    other=medians[against],
                    useless=", about that of Ĵ = 0, which is 1"
                    if medians[against] > USELESS_ERROR
                    else "",
                    turned=_turned(table, kind, one, against),
                    phase=PHASES[kind][JUDGED],
                    medians="; ".join(
                        f"{ESTIMATOR_NAMES[k]} {error:.3f}" for k, error in medians.items()
                    ),
                )


def _turned(table: AccuracyTable, kind: Kind, measure: str, against: str) -> str:
    """Return the noises that reverse the comparison, as the end of a sentence."""
    noises = table.settings.noises
    ratios = {noise: table.ratio(kind, noise, measure, against) for noise in noises}
    turned = [n for n, ratio in ratios.items() if (ratio <= 1.0) != (ratios[noises[0]] <= 1.0)]
    others = ", ".join(f"{n:g} px of noise ({ratios[n]:.2g})" for n in turned)
    return f"; the comparison reverses with {others}" if turned else ""


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    table, noise, seeds = (
        AccuracyTable(settings, results),
        settings.noises[0],
        range(settings.seeds),
    )
    for kind, words in STREAMS.items():
        found = results[f"{kind}-0-{noise:g}"]
        panels = [
            Panel("time [s]", label, _series(found, one), log_y=True, y_limits=ERROR_AXIS)
            for one, label in MEASURES.items()
        ]
        title = f"All estimators in a {words}, seed 0, {noise:g} px of noise"
        piece = {"piece": found["time"][-1] / SERIES_LENGTH, "names": SHORT_NAMES_NOTE}
        figure = Figure(title, panels, columns=2)
        yield ReportFigure(f"accuracy-{kind}", [0], figure, words=piece, key="accuracy-time")
    panels = [
        Panel(
            "",
            f"{label}\n{PHASES[kind][JUDGED]}",
            [
                seed_marks(
                    [table.of_seeds(kind, px, name, one) for name in ESTIMATORS],
                    f"{px:g} px of noise",
                    style,
                )
                for style, px in enumerate(settings.noises)
            ],
            log_y=True,
            categories=SHORT_NAMES,
        )
        for kind in STREAMS
        for one, label in MEASURES.items()
    ]
    figure = Figure("Accuracy by seed", panels, columns=2)
    yield ReportFigure("accuracy-seeds", seeds, figure, words={"names": SHORT_NAMES_NOTE})
    yield ReportFigure(
        "accuracy-phases", seeds, _by_phase(table, noise), words={"names": SHORT_NAMES_NOTE}
    )


def _series(found: TaskResult, measure: str) -> list[Curve]:
    return [
        make_curve(
            SHORT_NAMES[style] if measure == "full" else "",
            found["time"],
            found["errors"][name][measure]["series"],
            style,
        )
        for style, name in enumerate(ESTIMATORS)
    ]


def _by_phase(table: AccuracyTable, noise: float) -> Figure:
    phases = range(len(SERVO_PHASES))
    panels = [
        Panel(
            "",
            label,
            [
                make_curve(
                    SHORT_NAMES[style] if one == "full" else "",
                    phases,
                    [table.median("servo", noise, name, one, phase) for phase in phases],
                    style,
                    marks=True,
                )
                for style, name in enumerate(ESTIMATORS)
            ],
            log_y=True,
            y_limits=ERROR_AXIS,
            categories=list(SERVO_PHASES),
        )
        for one, label in MEASURES.items()
    ]
    return Figure("Accuracy by phase", panels, columns=2)
