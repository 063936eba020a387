"""Experiment `camera-knowledge`: calibration parameters identified in a servo run.

Tests the end of IV-B, and Proposition 1 in a servo run. The measure is the distance between
predicted and true markers at poses that the servo never visited. The flow rule has no parameters a
and can only extrapolate linearly.
"""

from collections.abc import Iterator
from functools import partial

from rcmservo.figures.charts import Figure, Panel
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.closed_loop import FLOW_EXPLORATION, PAPER_SCENES
from rcmservo.paper.lab.knowledge import servo_run
from rcmservo.paper.lab.streams import ESTIMATOR_NAMES, ESTIMATORS, SHORT_NAMES, SHORT_NAMES_NOTE
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, finite, median, seed_marks

WITH_MODEL = [name for name, estimator in ESTIMATORS.items() if estimator.predicts_markers]


def fixed_settings() -> dict[str, object]:
    return {"estimators": ESTIMATORS, "scene": PAPER_SCENES, "exploration": FLOW_EXPLORATION}


def tasks(settings: Settings) -> list[Task]:
    """Return the servo runs; the experiment `jacobian-accuracy` shares them."""
    return [
        Task(f"servo-{seed}-{noise:g}", servo_task(settings, seed, noise), cost=4.0)
        for seed in range(settings.seeds)
        for noise in settings.noises
    ]


def servo_task(settings: Settings, seed: int, noise: float) -> "partial[TaskResult]":
    """Return the function that performs one servo run."""
    return partial(
        servo_run,
        seed=seed,
        noise=noise,
        duration=settings.duration,
        held_out=settings.held_out,
        around=settings.around,
        speed=settings.least_speed,
    )


def knowledge_of(
    settings: Settings, results: Results, noise: float, name: str, what: str
) -> Floats:
    """Return one entry of the knowledge of an estimator, for each scene."""
    runs = [results[f"servo-{seed}-{noise:g}"] for seed in range(settings.seeds)]
    return column(runs, "knowledge", name, what)


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    noise, seeds = settings.noises[0], range(settings.seeds)
    for name in WITH_MODEL:
        near = {
            n: median(knowledge_of(settings, results, n, name, "near")) for n in settings.noises
        }
        beyond = [n for n, px in near.items() if px > settings.known]
        workspace = median(knowledge_of(settings, results, noise, name, "workspace"))
        yield Measurement(
            "knows-camera",
            near[noise],
            seeds,
            bound=settings.known,
            case=(ESTIMATOR_NAMES[name],),
            trapped=name == "real time",
            confirmed=near[noise] > settings.known,
            beyond="; ".join(
                f"with {n:g} px of noise it is {format_short(near[n])} px" for n in beyond
            ),
            listed=", ".join(f"{format_short(px)} px with {n:g} px" for n, px in near.items()),
            workspace=format_short(workspace),
            wrong=median(finite(knowledge_of(settings, results, noise, name, "parameters"))),
        )
    flow, other = (
        knowledge_of(settings, results, noise, name, "near") for name in ("flow", "random")
    )
    yield Measurement(
        "flow-does-not",
        median(flow / other),
        seeds,
        near=format_short(median(flow)),
        workspace=format_short(median(knowledge_of(settings, results, noise, "flow", "workspace"))),
    )


def format_short(number: float) -> str:
    """Format a number with two significant digits, or as an integer from 10 on."""
    return f"{number:.0f}" if number >= 10.0 else f"{number:.2g}"


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    regions = {
        "near": f"within {settings.around:g} mm of the path",
        "workspace": "anywhere in the image",
    }
    panels = [
        Panel(
            "",
            f"error of the predicted markers [px]\n{words}",
            [
                seed_marks(
                    [knowledge_of(settings, results, noise, name, what) for name in ESTIMATORS],
                    f"{noise:g} px of noise",
                    style,
                )
                for style, noise in enumerate(settings.noises)
            ],
            log_y=True,
            categories=SHORT_NAMES,
        )
        for what, words in regions.items()
    ]
    figure = Figure("Prediction at unvisited poses", panels, columns=2)
    yield ReportFigure(
        "accuracy-poses", range(settings.seeds), figure, words={"names": SHORT_NAMES_NOTE}
    )
