"""Precision of the image where the tool is: how far the tool may be off for an error in pixels.

H (4, 3) px/mm is the derivative of both markers with respect to marker 1 by the fitted projection.
An error of e px moves the tool by up to e/σ₃ mm, with the smallest singular value σ₃ of H. The
direction in which it does is often that of the line of sight.
"""

from typing import Any

import numpy as np

from rcmservo.estimation.camera_fit_prediction import compute_markers_jacobian, predict_image
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.servo.state import State

TRACKING_ERROR_PX = 0.1
"""Usual error (px) of a tracked marker that no average removes."""

MAX_ERROR_MM = 1.0
"""Error (mm) of the pose from which a warning follows."""

REACH_MM = 10.0
"""Distance (mm) from marker 1 at which the fit must predict the markers.

It must predict them better than they move over this distance in the weakest direction. After an
exploration the precision is then within a third of the true one.
"""


def compute_mm_per_px(state: State, tool: Tool) -> float:
    """Return the motion (mm) of marker 1 per px in the direction that the image shows least.

    It is that at the newest accepted frame, and NaN as long as the fit does not determine it.
    """
    p1, fit = state.estimation.estimate.p1, state.estimation.projection_fit.rows[0]
    H = np.nan_to_num(compute_markers_jacobian(fit, p1, tool.struct))
    _, singular_values, directions = np.linalg.svd(H)
    least, step = singular_values[2], REACH_MM * directions[2]
    deviations = [_predict_deviation(fit, p1 + sign * step, tool) for sign in (1.0, -1.0)]
    return float(1.0 / least) if max(deviations) < least * REACH_MM else np.nan


def _predict_deviation(fit: Any, p1: Floats, tool: Tool) -> float:
    """Return the standard deviation (px) of both predicted markers together."""
    covariances = [predict_image(fit, p)[1] for p in (p1, tool.second_marker(p1))]
    return float(np.sqrt(sum(np.trace(covariance) for covariance in covariances)))


def describe_precision(state: State, tool: Tool) -> str:
    """Return a sentence on the precision of the image; empty as long as it is unknown."""
    error_mm = TRACKING_ERROR_PX * compute_mm_per_px(state, tool)
    if np.isnan(error_mm):
        return ""
    words = f"{TRACKING_ERROR_PX:g} px is {error_mm:.2g} mm here in the weakest direction"
    if not error_mm >= MAX_ERROR_MM:
        return words
    return (
        f"{words}: do not expect errors below {MAX_ERROR_MM:g} mm; move the camera nearer, or to "
        "where it sees the tool from another side"
    )
