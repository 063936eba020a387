"""Weights of the markers in a frame, by which the projection fit ignores false detections.

A marker with the innovation e (px), its difference from the prediction of the fit, has the weight

    w = min(1, c²/d²),    d² = eᵀ (C + σ² I)⁻¹ e

with the covariance C of the prediction, the noise variance σ² of the fit, and c = 6. Weights of
false detections are thus small, and those of all others are 1. A false detection that counts
increases σ², and with it what the next ones may deviate by; C and σ² therefore enter with a noise
of 2 px at most. If the fit itself is wrong, right markers have small weights, but most of them
agree with each other and change it in the end.
"""

from rcmservo.estimation.camera_fit import ProjectedPoint, ProjectionFit, project_markers
from rcmservo.estimation.camera_fit_prediction import (
    compute_image_covariance,
    squared_mahalanobis_distance,
)
from rcmservo.geometry.tool import ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled

OUTLIER_SIGMA = 6.0
"""Mahalanobis distance c from which the weight of a marker falls."""

MAX_NOISE_PX = 2.0
"""Largest noise (px) that a deviation is attributed to."""

MIN_OUTLIER_PX = 4.0
"""Smallest innovation (px) of a false detection; lens, arm and tool may explain a smaller one."""


@compiled
def weigh_markers(fit: ProjectionFit, p1: Floats, points: Floats, shaft: ToolStruct) -> None:
    """Write `fit.marker_weights` of a frame with the raw `points` (2, 2) px at p1 (3,) mm.

    A marker before the first frame, or one that is lost (NaN), has the weight 1.
    """
    predictions = project_markers(fit, p1, shaft)
    for k in range(2):
        fit.marker_weights[k] = compute_weight(fit, predictions[k], points[k])


@compiled
def compute_weight(fit: ProjectionFit, prediction: ProjectedPoint, point: Floats) -> float:
    """Return the weight of a marker at `point` (2,) raw px, from 0 to 1."""
    u = point[0] - fit.origin[3] - prediction.m[0]
    v = point[1] - fit.origin[4] - prediction.m[1]
    if not u * u + v * v > MIN_OUTLIER_PX**2:
        return 1.0
    covariance = compute_image_covariance(fit, prediction)
    squared = squared_mahalanobis_distance(u, v, covariance, fit.noise_variance)
    squared *= max(fit.noise_variance / MAX_NOISE_PX**2, 1.0)
    if not squared > OUTLIER_SIGMA**2:
        return 1.0
    return OUTLIER_SIGMA**2 / squared
