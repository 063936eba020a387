"""Check of the end of IV-B: the calibration parameters a that a servo run identifies.

Experiment `camera-knowledge`, which also tests Proposition 1 in a servo run. The measure is the
distance between predicted and true markers at poses that the servo never visited. The flow rule has
no parameters a and can only extrapolate linearly.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.camera_fit import UNIT_LENGTH_MM, ProjectionFit
from rcmservo.estimation.projection_rule import GAMMA_0
from rcmservo.figures.charts import Figure, Panel
from rcmservo.geometry.features import compute_features, shift_to_rcm
from rcmservo.geometry.projection import extract_parameters
from rcmservo.interfaces import Floats
from rcmservo.paper.lab import streams
from rcmservo.paper.lab.cameras import true_parameters
from rcmservo.paper.lab.streams import ESTIMATORS
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, finite, median, seed_marks
from rcmservo.sim import Rig

CONFIGURATION_DRAWS = 2000
"""Random configurations in the whole workspace; a few of them are visible."""
PHASES: tuple[str, ...] = ("exploration", "saturated", "end")
"""Phases of a servo run."""
RUN_SETTINGS = ("duration", "held_out", "around", "least_speed")
"""Settings that the servo runs depend on."""


def tasks(settings: Settings) -> list[Task]:
    """Return the servo runs; the experiment `jacobian-accuracy` shares them."""
    run_settings = {name: getattr(settings, name) for name in RUN_SETTINGS}
    return [
        Task(f"servo-{i}-{px:g}", partial(servo_run, seed=i, noise=px, **run_settings), cost=4.0)
        for i in range(settings.seeds)
        for px in settings.noises
    ]


def servo_run(
    seed: int, noise: float, duration: float, held_out: int, around: float, least_speed: float
) -> TaskResult:
    """Run each estimator on the samples of one servo run; return errors of Ĵ and of predictions.

    Parameters
    ----------
    seed
        Seed of the scene and of the noise.
    noise
        Standard deviation (px) of the markers.
    duration
        Duration (s) of the run.
    held_out
        Number of poses per region for predictions.
    around
        Distance (mm) from the path of the poses nearby.
    least_speed
        Smallest speed (mm/s) that defines a direction of motion.

    Returns
    -------
    TaskResult
        By estimator: errors of Ĵ, and as knowledge the median error (px) of the predicted markers
        near the path and anywhere in the image, and the relative error of â (None without â).
    """
    rig, stream = streams.record_stream(seed, noise, Settings(duration=duration), "servo")
    near = draw_poses_near_path(rig, held_out, around, seed)
    anywhere = draw_poses_in_workspace(rig, held_out, seed)
    errors, knowledge = dict[str, TaskResult](), dict[str, TaskResult]()
    for name, compared in ESTIMATORS.items():
        estimator, samples = compared.estimator, stream.samples
        J_hat, memory = streams.run_estimator(estimator, samples, rig.settings.tool)
        errors[name] = streams.summarise_jacobian_errors(J_hat, stream, least_speed, len(PHASES))
        known = estimator, memory, J_hat[-1], samples[-1]
        knowledge[name] = {
            "near": prediction_error(rig, near, *known),
            "workspace": prediction_error(rig, anywhere, *known),
            "parameters": parameter_error(rig, parameters_of(estimator, memory))
            if estimator.predicts_markers
            else None,
        }
    time = streams.median_series(stream.time)
    return {"time": time, "errors": errors, "knowledge": knowledge}


def draw_poses_near_path(rig: Rig, count: int, around: float, seed: int) -> list[Floats]:
    """Return the joints of visible poses with marker 1 within `around` mm of the path."""
    random = np.random.default_rng(seed)
    poses: list[Floats] = []
    while len(poses) < count:
        offset = random.standard_normal(3)
        offset *= around * random.uniform() ** (1.0 / 3.0) / np.linalg.norm(offset)
        on_path = np.asarray(random.choice(rig.scene.path))
        q = rig.body.mechanism.joints(rig.body.points(on_path)[0] + offset)
        if are_markers_visible(rig, q):
            poses.append(q)
    return poses


def draw_poses_in_workspace(rig: Rig, count: int, seed: int) -> list[Floats]:
    """Return the joints of visible poses anywhere within the joint limits."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(*rig.body.mechanism.limits.arrays, (CONFIGURATION_DRAWS, 3))
    return [q for q in drawn if are_markers_visible(rig, q)][:count]


def are_markers_visible(rig: Rig, q: Floats) -> bool:
    """Return True if both markers are in the image at the joints `q` (3,)."""
    pixels, optics = rig.truth.pixels(q), rig.scene.optics
    return bool(((pixels >= 0.0) & (pixels <= np.array([optics.width, optics.height]) - 1.0)).all())


def prediction_error(
    rig: Rig,
    poses: Sequence[Floats],
    estimator: Estimator,
    memory: Any,
    J_hat: Floats,
    last: Sample,
) -> float:
    """Return the median distance (px) between predicted and true markers at `poses`.

    The predictions use the state of the estimator after its `last` sample.
    """
    errors = list[Floats]()
    for q in poses:
        p1 = rig.body.points(q)[0]
        m = estimator.predict(memory, rig.settings.tool, p1)
        m = extrapolate_features(J_hat, last, p1) if m is None else m
        rcm = estimator.imaged_rcm(memory)
        o_c = last.o_c if rcm is None else rcm[0]
        errors.append(m.reshape(2, 2) + o_c - rig.truth.pixels(q))
    return median(np.linalg.norm(np.concatenate(errors), axis=1))


def extrapolate_features(J_hat: Floats, last: Sample, p1: Floats) -> Floats:
    """Return m (4,) in px from o_c at `p1`, by linear extrapolation of y with the scaled Ĵ."""
    scale = 1.0 / scale_rows(np.ones((3, 1)))[:, 0]
    y = compute_features(shift_to_rcm(last.points, last.o_c))
    s, r, d = y + scale * (J_hat @ (p1 - last.p1))
    along = np.array([np.cos(s), np.sin(s)])
    return np.concatenate([r * along, (r + d) * along])


def parameters_of(estimator: Estimator, memory: Any) -> Floats:
    """Return â (9,) of an estimator with a model; for a fit of the projection, by Lemma 1."""
    if not estimator.estimates_rcm:
        return memory.a_hat
    fit = ProjectionFit(memory)
    shift = np.eye(4)
    shift[:3, 3] = -fit.origin[:3]
    shift[3, 3] = UNIT_LENGTH_MM
    last_row = np.append(fit.g, 1.0)
    C = np.vstack([fit.A + np.outer(fit.origin[3:], last_row), last_row]) @ shift
    return extract_parameters(C)[0]


def parameter_error(rig: Rig, a_hat: Floats) -> float:
    """Return the relative error of â in the norm of (22) with the paper's Γ₀.

    The true a is that of the camera without distortion.
    """
    a, _ = true_parameters(rig)
    weight = 1.0 / np.sqrt(GAMMA_0)
    return float(np.linalg.norm(weight * (a_hat - a)) / np.linalg.norm(weight * a))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    noise, seeds = settings.noises[0], range(settings.seeds)
    for name, compared in ESTIMATORS.items():
        if not compared.estimator.predicts_markers:
            continue
        near = {
            px: median(list_knowledge(settings, results, px, name, "near"))
            for px in settings.noises
        }
        inaccurate = [
            f"with {px:g} px of noise it is {format_short(error)} px"
            for px, error in near.items()
            if error > settings.known
        ]
        workspace = median(list_knowledge(settings, results, noise, name, "workspace"))
        yield Measurement(
            "knows-camera",
            near[noise],
            seeds,
            bound=settings.known,
            case=(compared.name,),
            trapped=name == "real time",
            confirmed=near[noise] > settings.known,
            beyond="; ".join(inaccurate),
            listed=", ".join(f"{format_short(e)} px with {px:g} px" for px, e in near.items()),
            workspace=format_short(workspace),
            wrong=median(finite(list_knowledge(settings, results, noise, name, "parameters"))),
        )
    flow, other, workspace = (
        list_knowledge(settings, results, noise, name, region)
        for name, region in (("flow", "near"), ("random", "near"), ("flow", "workspace"))
    )
    texts = Texts(near=format_short(median(flow)), workspace=format_short(median(workspace)))
    yield Measurement("flow-does-not", median(flow / other), seeds, **texts)


def list_knowledge(
    settings: Settings, results: Results, noise: float, name: str, entry: str
) -> Floats:
    """Return one entry of the knowledge of an estimator, for each scene."""
    runs = [results[f"servo-{seed}-{noise:g}"] for seed in range(settings.seeds)]
    return column(runs, "knowledge", name, entry)


def format_short(number: float) -> str:
    """Format a number with two significant digits, or as an integer from 10 on."""
    return f"{number:.0f}" if number >= 10.0 else f"{number:.2g}"


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    regions = {
        "near": f"within {settings.around:g} mm of the path",
        "workspace": "anywhere in the image",
    }
    panels, seeds = list[Panel](), range(settings.seeds)
    for region, description in regions.items():
        curves = [
            seed_marks(
                [list_knowledge(settings, results, noise, name, region) for name in ESTIMATORS],
                f"{noise:g} px of noise",
                style,
            )
            for style, noise in enumerate(settings.noises)
        ]
        label = f"error of the predicted markers [px]\n{description}"
        panels.append(Panel("", label, curves, log_y=True, categories=streams.SHORT_NAMES))
    figure = Figure("Prediction at unvisited poses", panels, columns=2)
    note = {"names": streams.SHORT_NAMES_NOTE}
    yield PaperFigure("accuracy-poses", seeds, figure, texts=note)
