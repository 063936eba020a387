"""Detection of frames that repeat an earlier exposure under a new number.

No two exposures of a moving tool show both markers at exactly the same pixels. A repeated frame is
not used, so that the last new frame ages. Many repeated frames in succession are a frozen image.
"""

import numpy as np

from rcmservo.estimation.camera_fit import ProjectionFit
from rcmservo.estimation.camera_fit_prediction import filter_markers
from rcmservo.geometry.tool import ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_distance, copy_into
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.innovation import find_lost_markers
from rcmservo.safety.monitor_state import MonitorState
from rcmservo.safety.thresholds import Thresholds

MIN_MOTION_PX = 0.5
"""Motion (px) that the fit predicts for a marker and that changes its pixels in every tracker."""

MIN_MOTION_MM = 0.1
"""Motion (mm) of marker 1 that counts instead while no fit predicts pixels."""


@compiled
def detect_repeated_frame(
    monitor: MonitorState,
    fit: ProjectionFit,
    is_explored: bool,
    p1: Floats,
    detected: Floats,
    tool: ToolStruct,
    thresholds: Thresholds,
) -> bool:
    """Return True if a frame shows exactly the markers of an earlier one although the tool moved.

    A coarse tracker may not see a small motion. Therefore only the first repetitions are left out
    unless the motion is as large as one that a frozen image hides.

    Parameters
    ----------
    monitor : MonitorState
        State of the checks; updated.
    fit : ProjectionFit
        Fit of the camera's projection.
    is_explored : bool
        True if the exploration has ended, so that the fit predicts the markers.
    p1 : Floats
        Position of marker 1, (3,) mm.
    detected : Floats
        Markers as they were detected, (2, 2) raw px, NaN where lost.
    tool : ToolStruct
        Tool, which gives the position of marker 2.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    first_is_lost, second_is_lost = find_lost_markers(detected)
    if first_is_lost and second_is_lost:
        return False
    if not same_markers(detected, monitor.changed_markers):
        copy_into(monitor.changed_markers, detected)
        copy_into(monitor.changed_markers_p1, p1)
        monitor.repeated_frames, monitor.image_frozen = 0, False
        return False
    motion_mm, motion_px = compute_distance(p1, monitor.changed_markers_p1), 0.0
    if is_explored:
        motion_px = predict_motion_px(fit, p1, monitor.changed_markers_p1, tool)
    hides_motion = motion_mm > thresholds.frozen_image_motion or motion_px > thresholds.max_drift_px
    is_visible = motion_px > MIN_MOTION_PX if is_explored else motion_mm > MIN_MOTION_MM
    has_moved = hides_motion or is_visible
    monitor.repeated_frames = monitor.repeated_frames + 1 if has_moved else 0
    is_long = monitor.repeated_frames >= thresholds.max_rejected_frames
    monitor.image_frozen = is_long and hides_motion
    return has_moved and (hides_motion or not is_long)


@compiled
def predict_motion_px(
    fit: ProjectionFit, p1: Floats, earlier_p1: Floats, tool: ToolStruct
) -> float:
    """Return the larger motion (px) of a marker between two positions (3,) mm of marker 1."""
    markers, earlier_markers = filter_markers(fit, p1, tool), filter_markers(fit, earlier_p1, tool)
    return max(
        compute_distance(markers[0], earlier_markers[0]),
        compute_distance(markers[1], earlier_markers[1]),
    )


@compiled
def same_markers(one: Floats, other: Floats) -> bool:
    """Return True if two arrays (2, 2) of markers are equal; NaN equals NaN."""
    for i in np.ndindex(one.shape):
        if not (one[i] == other[i] or (np.isnan(one[i]) and np.isnan(other[i]))):
            return False
    return True


@compiled
def image_is_frozen(facts: TickFacts) -> bool:
    """Detect an image that does not change while the tool moves."""
    return facts.monitor.image_frozen and not facts.exploration_state.has_no_room
