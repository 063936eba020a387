"""Detectors of markers that drift away from their prediction, or that do not move with the tool.

The innovation gate (innovation.py) detects an error in one frame. A camera that pans, rolls, zooms
or approaches, and a decoy marker that slides along, cause a small error in every frame: the mean
residual over a third of a second detects it, because averaging reduces the noise. A frozen image is
the same to the last bit, which no camera delivers while the tool moves.
"""

import numpy as np

from rcmservo.estimation.camera_fit import ProjectedPoint, ProjectionFit, project_markers
from rcmservo.estimation.camera_fit_prediction import image_covariance
from rcmservo.geometry.tool import ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_distance, compute_norm, copy_into
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.innovation import squared_mahalanobis_distance
from rcmservo.safety.monitor_state import MonitorState
from rcmservo.safety.thresholds import Thresholds

STUCK_MOTION_RATIO = 5.0
"""A marker is stuck if the other one moves by more than this multiple of its largest motion."""

SINGLE_DRIFT_RATIO = 3.0
"""A marker drifts alone if its mean residual exceeds this multiple of the other's."""


@compiled
def update_drift(
    watch: MonitorState,
    fit: ProjectionFit,
    p1: Floats,
    points: Floats,
    detected: Floats,
    shaft: ToolStruct,
    thresholds: Thresholds,
) -> None:
    """Update the mean residuals, and detect a frozen image, with a new frame.

    Parameters
    ----------
    watch : MonitorState
        State of the checks; updated.
    fit : ProjectionFit
        Fit of the camera's projection.
    p1 : Floats
        Position of marker 1, (3,) mm.
    points : Floats
        Markers, (2, 2) raw px; a lost one is replaced by its prediction.
    detected : Floats
        Markers as they were detected, (2, 2) raw px, NaN where lost.
    shaft : ToolStruct
        Tool, which gives the position of marker 2.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    predicted = project_markers(fit, p1, shaft)
    watch.averaged_frames = min(watch.averaged_frames + 1, thresholds.drift_frames)
    for k in range(2):
        update_mean_residual(watch, fit, k, predicted[k], points[k], thresholds)
    same = same_markers(detected, watch.changed_markers)
    largest = max_difference(watch.markers_prediction, watch.changed_markers_prediction)
    moved = (
        compute_distance(p1, watch.changed_markers_p1) > thresholds.frozen_image_motion
        or largest > thresholds.max_drift_px
    )
    watch.image_frozen = same and moved
    if not same:
        copy_into(watch.changed_markers, detected)
        copy_into(watch.changed_markers_p1, p1)
        copy_into(watch.changed_markers_prediction, watch.markers_prediction)


@compiled
def detect_stuck_markers(
    watch: MonitorState, p1: Floats, points: Floats, thresholds: Thresholds
) -> tuple[bool, bool]:
    """Detect a stuck marker or a frozen image before an estimate exists.

    A marker is stuck if it does not move while the other does. If neither changes at all while the
    tool moves, the image is frozen.

    Parameters
    ----------
    watch : MonitorState
        State of the checks; updated.
    p1 : Floats
        Position of marker 1, (3,) mm.
    points : Floats
        Markers, (2, 2) raw px.
    thresholds : Thresholds
        Thresholds of the checks.

    Returns
    -------
    tuple[bool, bool]
        True if marker 1, marker 2 is stuck.
    """
    same, motion, limit = (
        same_markers(points, watch.changed_markers),
        np.empty(2),
        thresholds.stuck_marker_px,
    )
    watch.image_frozen = (
        same and compute_distance(p1, watch.changed_markers_p1) > thresholds.frozen_image_motion
    )
    if not same:
        copy_into(watch.changed_markers, points)
        copy_into(watch.changed_markers_p1, p1)
    for k in range(2):
        if not compute_distance(points[k], watch.stuck_anchors[k, :2]) <= limit:
            copy_into(watch.stuck_anchors[k, :2], points[k])
            copy_into(watch.stuck_anchors[k, 2:], points[1 - k])
        motion[k] = compute_distance(points[1 - k], watch.stuck_anchors[k, 2:])
    return motion[0] > STUCK_MOTION_RATIO * limit, motion[1] > STUCK_MOTION_RATIO * limit


@compiled
def update_mean_residual(
    watch: MonitorState,
    fit: ProjectionFit,
    k: int,
    predicted: ProjectedPoint,
    point: Floats,
    thresholds: Thresholds,
) -> None:
    """Average the residual of marker k at `point` (2,) raw px, and test the mean against noise.

    The residual is clipped: as many frames as may be rejected in succession cannot move the mean by
    `max_drift_px`.
    """
    place = watch.markers_prediction[k]
    place[0], place[1] = fit.origin[3] + predicted.m[0], fit.origin[4] + predicted.m[1]
    most_outliers = np.sqrt(2.0) * (thresholds.max_rejected_frames + 1)
    bound = thresholds.max_drift_px * thresholds.drift_frames / most_outliers
    for i in range(2):
        clipped = min(max(point[i] - place[i], -bound), bound)
        watch.mean_residual[k, i] += (clipped - watch.mean_residual[k, i]) / watch.averaged_frames
    noise, mean, error = (
        fit.noise_variance / watch.averaged_frames,
        watch.mean_residual[k],
        compute_norm(watch.mean_residual[k]),
    )
    sigmas = thresholds.max_drift_sigma**2
    explained = error * error <= sigmas * noise  # the fit's own covariance only adds to the noise
    if not explained:
        cov = image_covariance(fit, predicted)
        explained = not squared_mahalanobis_distance(mean[0], mean[1], cov, noise) > sigmas
    watch.drift_px[k] = 0.0 if explained else error


@compiled
def same_markers(one: Floats, other: Floats) -> bool:
    """Return True if two arrays (2, 2) of markers are equal; NaN equals NaN."""
    for k in range(2):
        for i in range(2):
            a, b = one[k, i], other[k, i]
            if not (a == b or (np.isnan(a) and np.isnan(b))):
                return False
    return True


@compiled
def max_difference(one: Floats, other: Floats) -> float:
    """Return the largest absolute difference of two arrays (2, 2); NaN if a number is NaN."""
    most = 0.0
    for k in range(2):
        for i in range(2):
            difference = abs(one[k, i] - other[k, i])
            if np.isnan(difference):
                return np.nan
            most = max(most, difference)
    return most


@compiled
def image_is_frozen(facts: TickFacts) -> bool:
    """Detect an image that does not change while the tool moves."""
    return facts.monitor.image_frozen and not facts.exploration_state.has_no_room


@compiled
def markers_deviate(facts: TickFacts) -> bool:
    """Return True if the mean residual of a marker is too large."""
    watch, thresholds = facts.monitor, facts.thresholds
    known = (
        facts.exploration_state.is_done
        and not watch.image_frozen
        and watch.averaged_frames >= thresholds.drift_frames
    )
    return known and max(watch.drift_px[0], watch.drift_px[1]) > thresholds.max_drift_px


@compiled
def one_marker_deviates(facts: TickFacts) -> bool:
    """Return True if the mean residual of one marker alone is too large."""
    off = facts.monitor.drift_px
    return markers_deviate(facts) and max(off[0], off[1]) > SINGLE_DRIFT_RATIO * min(off[0], off[1])


@compiled
def markers_drift(facts: TickFacts) -> bool:
    """Detect that both markers drift away from their prediction."""
    return markers_deviate(facts) and not one_marker_deviates(facts)
