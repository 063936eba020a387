"""Detectors of markers that are lost, swapped or repeatedly far from their predictions.

Marker 1 is the one nearer the RCM, marker 2 the one nearer the tip. A frame is rejected if a marker
is too far from its prediction (`rcmservo.safety.innovation`).
"""

from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.drift import one_marker_deviates
from rcmservo.safety.checks.exploration import markers_are_in_reverse_order
from rcmservo.safety.checks.facts import DetailFacts, TickFacts, has_frame
from rcmservo.safety.innovation import find_lost_markers

SCATTERED_FACTOR = 2
"""Multiple of `max_rejected_frames` at which false detections stop the tool that scatter in the
image: single wrong frames then seldom follow each other that long."""


@compiled
def both_markers_are_lost(facts: TickFacts) -> bool:
    """Detect a frame in which neither marker is detected."""
    first_is_lost, second_is_lost = find_lost_markers(facts.observation.points)
    return has_frame(facts) and first_is_lost and second_is_lost


@compiled
def marker_1_is_lost(facts: TickFacts) -> bool:
    """Detect the loss of marker 1 where marker 2 does not determine the pose."""
    return find_single_lost_marker(facts) == 1 and not facts.monitor.one_marker_suffices


@compiled
def marker_2_is_lost(facts: TickFacts) -> bool:
    """Detect the loss of marker 2 where marker 1 does not determine the pose."""
    return find_single_lost_marker(facts) == 2 and not facts.monitor.one_marker_suffices


@compiled
def marker_1_is_completed(facts: TickFacts) -> bool:
    """Detect the loss of marker 1 where marker 2 and the joints determine the pose."""
    return find_single_lost_marker(facts) == 1 and facts.monitor.one_marker_suffices


@compiled
def marker_2_is_completed(facts: TickFacts) -> bool:
    """Detect the loss of marker 2 where marker 1 and the joints determine the pose."""
    return find_single_lost_marker(facts) == 2 and facts.monitor.one_marker_suffices


@compiled
def find_single_lost_marker(facts: TickFacts) -> int:
    """Return the number (1 or 2) of the only marker that is lost; 0 if none or both are lost."""
    first_is_lost, second_is_lost = find_lost_markers(facts.observation.points)
    if first_is_lost == second_is_lost or not has_frame(facts):
        return 0
    return 1 if first_is_lost else 2


@compiled
def frame_was_rejected(facts: TickFacts) -> bool:
    """Detect that the innovation gate rejected the newest frame."""
    return has_frame(facts) and facts.monitor.rejected_frames > 0


@compiled
def frames_are_rejected(facts: TickFacts) -> bool:
    """Return True if enough successive frames were rejected to stop the tool."""
    limit = facts.thresholds.max_rejected_frames
    return has_frame(facts) and facts.monitor.rejected_frames >= limit


@compiled
def markers_exchanged_positions(facts: TickFacts) -> bool:
    """Return True if each marker repeatedly appears at the other marker's position."""
    limit = facts.thresholds.max_rejected_frames
    return frames_are_rejected(facts) and facts.monitor.swapped_frames >= limit


@compiled
def markers_are_swapped(facts: TickFacts) -> bool:
    """Detect markers that exchanged positions, or that an exploration finds swapped."""
    return markers_exchanged_positions(facts) or markers_are_in_reverse_order(facts)


@compiled
def camera_moved(facts: TickFacts) -> bool:
    """Detect that both markers jumped, or that no frame is accepted for a long time."""
    monitor, thresholds = facts.monitor, facts.thresholds
    has_jumped = monitor.jumped_frames >= thresholds.max_rejected_frames
    view_changed = has_jumped or monitor.rejected_frames >= thresholds.moved_camera_frames
    is_explained = markers_exchanged_positions(facts) or markers_stand_still(facts)
    return frames_are_rejected(facts) and view_changed and not is_explained


@compiled
def markers_are_unexpected(facts: TickFacts) -> bool:
    """Detect that markers jump without a moved camera, or that one marker alone drifts."""
    monitor, limit = facts.monitor, facts.thresholds.max_rejected_frames
    is_explained = camera_moved(facts) or markers_exchanged_positions(facts)
    is_long = monitor.rejected_frames >= SCATTERED_FACTOR * limit
    persists = frames_are_rejected(facts) and (monitor.steady_frames >= limit or is_long)
    is_explained = is_explained or markers_stand_still(facts)
    return (persists and not is_explained) or one_marker_deviates(facts)


@compiled
def markers_stand_still(facts: TickFacts) -> bool:
    """Detect a marker that does not move with the tool while it explores."""
    monitor, is_explored = facts.monitor, facts.exploration_state.is_done
    return frames_are_rejected(facts) and monitor.still_markers != 0 and not is_explored


def describe_still_markers(facts: DetailFacts) -> str:
    """Describe the markers that do not move with the tool."""
    numbers = [k for k in range(2) if facts.monitor.still_markers >> k & 1]
    places = [
        f"marker {k + 1} at ({facts.observation.points[k, 0]:.0f}, "
        f"{facts.observation.points[k, 1]:.0f}) px"
        for k in numbers
    ]
    return " and ".join(places)
