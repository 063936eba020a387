"""Check of IV-B: the accuracy of both estimators of the paper, compared on equal terms.

Experiment `jacobian-accuracy`. Two errors of Ĵ are computed at each frame: of the whole matrix,
‖Ĵ − J‖/‖J‖, and along the present motion v, ‖(Ĵ − J)v‖/‖Jv‖, the only direction that the flow rule
(28) observes. The printed Γ is tested in real time and with 10⁴ s of estimator time per frame, on
random observations as in the paper, and on observations selected by leverage as in the built-in
estimators.
"""

from collections.abc import Iterator
from functools import partial
from itertools import product

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.paper import camera_knowledge_claims
from rcmservo.paper.camera_knowledge_claims import PHASES as SERVO_PHASES
from rcmservo.paper.lab import streams
from rcmservo.paper.lab.streams import ESTIMATORS, SHORT_NAMES, StreamKind
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, finite, median, seed_marks

PHASES: dict[StreamKind, tuple[str, ...]] = {
    "servo": SERVO_PHASES,
    "tour": ("initial exploration", "later exploration"),
}
JUDGED_PHASE = 1
"""Index of the phase, in both kinds of stream, that the claims concern."""
COMPARED_ESTIMATORS = ("random", "given time", "real time")
"""Estimators that the claims compare with the flow rule."""
STREAM_NAMES: dict[StreamKind, str] = {"servo": "servo run", "tour": "fast exploration"}
MEASURE_LABELS = {
    "full": "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
    "along": "$\\|(\\hat{J} - J)v\\| / \\|Jv\\|$ [1]",
}
MEASURE_NAMES = {"full": "whole matrix", "along": "along the motion"}
ERROR_AXIS = (1e-5, 20.0)
"""Limits of the error axes, with space for the legend below the curves."""
USELESS_ERROR = 0.9
"""Relative error of Ĵ from which on Ĵ is no better than 0."""
NAMES_NOTE = {"names": streams.SHORT_NAMES_NOTE}


def tasks(settings: Settings) -> list[Task]:
    """Return the servo runs, shared with `camera-knowledge`, and the explorations."""
    work = partial(explore, settings=settings)
    explorations = [
        Task(f"tour-{seed}-{noise:g}", partial(work, seed=seed, noise=noise), 2.0)
        for seed in range(settings.seeds)
        for noise in settings.noises
    ]
    return [*camera_knowledge_claims.tasks(settings), *explorations]


def explore(settings: Settings, seed: int, noise: float) -> TaskResult:
    """Run each estimator on the samples of one exploration; return the errors of Ĵ."""
    rig, stream = streams.record_stream(seed, noise, settings, "tour")
    errors: dict[str, TaskResult] = {}
    for name, compared in ESTIMATORS.items():
        J_hat, _ = streams.run_estimator(compared.estimator, stream.samples, rig.settings.tool)
        phases = len(PHASES["tour"])
        errors[name] = streams.summarise_jacobian_errors(
            J_hat, stream, settings.least_speed, phases
        )
    return {"time": streams.median_series(stream.time), "errors": errors}


class AccuracyTable:
    """Errors of Ĵ by kind of stream, noise, estimator and kind of error."""

    def __init__(self, settings: Settings, results: Results) -> None:
        self.settings, self.results = settings, results

    def in_phases(self, kind: StreamKind, noise: float, name: str, error_kind: str) -> Floats:
        """Return the median error (seeds, phases) in each phase, for each seed."""
        runs = [self.results[f"{kind}-{i}-{noise:g}"] for i in range(self.settings.seeds)]
        return column(runs, "errors", name, error_kind, "phases")

    def judged(self, kind: StreamKind, noise: float, name: str, error_kind: str) -> Floats:
        """Return the median error (seeds,) in the phase that the claims concern."""
        return self.in_phases(kind, noise, name, error_kind)[:, JUDGED_PHASE]

    def ratio(self, kind: StreamKind, noise: float, other_name: str, error_kind: str) -> float:
        """Return the median over the seeds of the flow rule's error over another estimator's."""
        other = self.judged(kind, noise, other_name, error_kind)
        return median(finite(self.judged(kind, noise, "flow", error_kind) / other))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    table = AccuracyTable(settings, results)
    noise = settings.noises[0]
    seeds = range(settings.seeds)
    cases = product(COMPARED_ESTIMATORS, STREAM_NAMES, MEASURE_NAMES)
    for other_name, kind, error_kind in cases:
        ratio = table.ratio(kind, noise, other_name, error_kind)
        all_errors = {name: table.judged(kind, noise, name, error_kind) for name in ESTIMATORS}
        errors = {name: median(finite(values)) for name, values in all_errors.items()}
        listed = [f"{ESTIMATORS[name].name} {error:.3f}" for name, error in errors.items()]
        is_useless = errors[other_name] > USELESS_ERROR
        case = ESTIMATORS[other_name].name, f"{STREAM_NAMES[kind]}, {MEASURE_NAMES[error_kind]}"
        useless = ", about that of Ĵ = 0, which is 1" if is_useless else ""
        texts = Texts(flow=errors["flow"], other=errors[other_name], useless=useless)
        turned = list_reversing_noises(table, kind, other_name, error_kind)
        texts |= Texts(turned=turned, phase=PHASES[kind][JUDGED_PHASE], medians="; ".join(listed))
        yield Measurement("more-accurate", ratio, seeds, case=case, **texts)


def list_reversing_noises(
    table: AccuracyTable, kind: StreamKind, other_name: str, error_kind: str
) -> str:
    """Return the noises that reverse the comparison, as the end of a sentence."""
    noises = table.settings.noises
    ratios = {noise: table.ratio(kind, noise, other_name, error_kind) for noise in noises}
    is_flow_better = ratios[noises[0]] <= 1.0
    reversing = [px for px, ratio in ratios.items() if (ratio <= 1.0) != is_flow_better]
    listed = ", ".join(f"{px:g} px of noise ({ratios[px]:.2g})" for px in reversing)
    return f"; the comparison reverses with {listed}" if reversing else ""


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    table = AccuracyTable(settings, results)
    noise = settings.noises[0]
    seeds = range(settings.seeds)
    for kind, name in STREAM_NAMES.items():
        run = results[f"{kind}-0-{noise:g}"]
        panels = [
            Panel("time [s]", label, draw_series(run, error_kind), log_y=True, y_limits=ERROR_AXIS)
            for error_kind, label in MEASURE_LABELS.items()
        ]
        title = f"All estimators in a {name}, seed 0, {noise:g} px of noise"
        texts = {"piece": run["time"][-1] / streams.SERIES_LENGTH, **NAMES_NOTE}
        figure = Figure(title, panels, columns=2)
        yield PaperFigure(f"accuracy-{kind}", [0], figure, texts=texts, key="accuracy-time")
    panels = [
        draw_seeds(table, kind, error_kind)
        for kind in STREAM_NAMES
        for error_kind in MEASURE_LABELS
    ]
    figure = Figure("Accuracy by seed", panels, columns=2)
    yield PaperFigure("accuracy-seeds", seeds, figure, texts=NAMES_NOTE)
    panels = [draw_phases(table, noise, error_kind) for error_kind in MEASURE_LABELS]
    figure = Figure("Accuracy by phase", panels, columns=2)
    yield PaperFigure("accuracy-phases", seeds, figure, texts=NAMES_NOTE)


def draw_series(run: TaskResult, error_kind: str) -> list[Curve]:
    """Return the error over time of each estimator; the legend is in the first panel only."""
    return [
        make_curve(
            short if error_kind == "full" else "", run["time"], errors[error_kind]["series"], style
        )
        for style, (short, errors) in enumerate(
            zip(SHORT_NAMES, run["errors"].values(), strict=True)
        )
    ]


def draw_seeds(table: AccuracyTable, kind: StreamKind, error_kind: str) -> Panel:
    curves = [
        seed_marks(
            [table.judged(kind, px, name, error_kind) for name in ESTIMATORS],
            f"{px:g} px of noise",
            style,
        )
        for style, px in enumerate(table.settings.noises)
    ]
    label = f"{MEASURE_LABELS[error_kind]}\n{PHASES[kind][JUDGED_PHASE]}"
    return Panel("", label, curves, log_y=True, categories=SHORT_NAMES)


def draw_phases(table: AccuracyTable, noise: float, error_kind: str) -> Panel:
    phases, curves = range(len(SERVO_PHASES)), list[Curve]()
    for style, (name, compared) in enumerate(ESTIMATORS.items()):
        errors = table.in_phases("servo", noise, name, error_kind)
        medians = [median(finite(in_phase)) for in_phase in errors.T]
        label = compared.short if error_kind == "full" else ""
        curves.append(make_curve(label, phases, medians, style, marks=True))
    label, names = MEASURE_LABELS[error_kind], list(SERVO_PHASES)
    return Panel("", label, curves, log_y=True, y_limits=ERROR_AXIS, categories=names)
