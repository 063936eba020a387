"""Accuracy of an estimated camera: error of the predicted pixels at held-out poses."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.camera_fit import UNIT_LENGTH_MM, ProjectionFit
from rcmservo.estimation.projection_rule import GAMMA_0
from rcmservo.geometry.features import compute_features, shift_to_rcm
from rcmservo.geometry.projection import extract_parameters
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.cameras import true_parameters
from rcmservo.paper.lab.streams import (
    ESTIMATORS,
    jacobian_errors,
    median_series,
    run_estimator,
    stream,
    summarise_error,
)
from rcmservo.paper.plan import Settings, TaskResult
from rcmservo.paper.statistics import median
from rcmservo.sim import Rig

DRAWS = 2000
"""Random configurations in the whole workspace; a few of them are visible."""
PHASES = ("exploration", "saturated", "end")
"""Phases of a servo run."""


def servo_run(
    seed: int, noise: float, duration: float, held_out: int, around: float, speed: float
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
    speed
        Smallest speed (mm/s) that defines a direction of motion.

    Returns
    -------
    TaskResult
        By estimator: errors of Ĵ, and as knowledge the median error (px) of the predicted markers
        near the path and anywhere in the image, and the relative error of â (None without â).
    """
    rig, recorded = stream(seed, noise, Settings(duration=duration), "servo")
    near, far = near_path(rig, held_out, around, seed), workspace(rig, held_out, seed)
    errors, knowledge = dict[str, TaskResult](), dict[str, TaskResult]()
    for name, estimator in ESTIMATORS.items():
        J_hat, memory = run_estimator(estimator, recorded.samples, rig.settings.tool)
        errors[name] = {
            measure: summarise_error(error, recorded.phase, len(PHASES))
            for measure, error in jacobian_errors(J_hat, recorded, speed).items()
        }
        known = estimator, memory, J_hat[-1], recorded.samples[-1]
        knowledge[name] = {
            "near": prediction_error(rig, near, *known),
            "workspace": prediction_error(rig, far, *known),
            "parameters": parameter_error(rig, parameters_of(estimator, memory))
            if estimator.predicts_markers
            else None,
        }
    return {"time": median_series(recorded.time), "errors": errors, "knowledge": knowledge}


def near_path(rig: Rig, count: int, around: float, seed: int) -> list[Floats]:
    """Return the joints of visible poses with marker 1 within `around` mm of the path."""
    random = np.random.default_rng(seed)
    poses: list[Floats] = []
    while len(poses) < count:
        offset = random.standard_normal(3)
        offset *= around * random.uniform() ** (1.0 / 3.0) / np.linalg.norm(offset)
        on_path = np.asarray(random.choice(rig.scene.path))
        q = rig.body.mechanism.joints(rig.body.points(on_path)[0] + offset)
        if in_picture(rig, q):
            poses.append(q)
    return poses


def workspace(rig: Rig, count: int, seed: int) -> list[Floats]:
    """Return the joints of visible poses anywhere within the joint limits."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(*rig.body.mechanism.limits.arrays, (DRAWS, 3))
    return [q for q in drawn if in_picture(rig, q)][:count]


def in_picture(rig: Rig, q: Floats) -> bool:
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
    """Return the median distance (px) between predicted and true markers at `poses`."""
    errors = list[Floats]()
    for q in poses:
        p1 = rig.body.points(q)[0]
        errors.append(predicted(rig, estimator, memory, J_hat, last, p1) - rig.truth.pixels(q))
    return median(np.linalg.norm(np.concatenate(errors), axis=1))


def predicted(
    rig: Rig, estimator: Estimator, memory: Any, J_hat: Floats, last: Sample, p1: Floats
) -> Floats:
    """Return the predicted raw pixels (2, 2) at `p1` (3,) in mm, after the `last` sample."""
    m = estimator.predict(memory, rig.settings.tool, p1)
    placed = estimator.imaged_rcm(memory)
    m = extrapolated(J_hat, last, p1) if m is None else m
    return m.reshape(2, 2) + (last.o_c if placed is None else placed[0])


def extrapolated(J_hat: Floats, last: Sample, p1: Floats) -> Floats:
    """Return m (4,) in px from o_c at `p1`, by linear extrapolation of y with the scaled Ĵ."""
    unscale = 1.0 / scale_rows(np.ones((3, 1)))[:, 0]
    s, r, d = compute_features(shift_to_rcm(last.points, last.o_c)) + unscale * (
        J_hat @ (p1 - last.p1)
    )
    along = np.array([np.cos(s), np.sin(s)])
    return np.concatenate([r * along, (r + d) * along])


def parameters_of(estimator: Estimator, memory: Any) -> Floats:
    """Return â (9,) of an estimator with a model; for a fit of the projection, by Lemma 1."""
    if not estimator.estimates_rcm:
        return memory.a_hat
    fit = ProjectionFit(memory)
    moved = np.eye(4)
    moved[:3, 3] = -fit.origin[:3]
    moved[3, 3] = UNIT_LENGTH_MM
    below = np.append(fit.g, 1.0)
    C = np.vstack([fit.A + np.outer(fit.origin[3:], below), below]) @ moved
    return extract_parameters(C)[0]


def parameter_error(rig: Rig, a_hat: Floats) -> float:
    """Return the relative error of â in the norm of (22) with the printed Γ₀.

    The true a is that of the camera without distortion.
    """
    a, _ = true_parameters(rig)
    weight = 1.0 / np.sqrt(GAMMA_0)
    return float(np.linalg.norm(weight * (a_hat - a)) / np.linalg.norm(weight * a))
