"""Detectors of markers that are lost, or that frame after frame shows where no motion puts them."""

from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.drift import one_marker_deviates
from rcmservo.safety.checks.exploration import markers_stand_in_reverse
from rcmservo.safety.checks.facts import TickFacts, has_frame
from rcmservo.safety.innovation import lost


@compiled
def both_markers_are_lost(c: TickFacts) -> bool:
    """Detect a frame without markers."""
    first, second = lost(c.seen.points)
    return has_frame(c) and first and second


@compiled
def marker_1_is_lost(c: TickFacts) -> bool:
    """Detect the loss of marker 1 where the other does not suffice."""
    return lost_marker(c) == 1 and not c.watch.spared


@compiled
def marker_2_is_lost(c: TickFacts) -> bool:
    """Detect the loss of marker 2 where the other does not suffice."""
    return lost_marker(c) == 2 and not c.watch.spared


@compiled
def marker_1_is_completed(c: TickFacts) -> bool:
    """Detect the loss of marker 1 where the other and the joints suffice."""
    return lost_marker(c) == 1 and c.watch.spared


@compiled
def marker_2_is_completed(c: TickFacts) -> bool:
    """Detect the loss of marker 2 where the other and the joints suffice."""
    return lost_marker(c) == 2 and c.watch.spared


@compiled
def lost_marker(c: TickFacts) -> int:
    """Return which marker, 1 or 2, is lost while the other is not; 0 if none."""
    first, second = lost(c.seen.points)
    if first == second or not has_frame(c):
        return 0
    return 1 if first else 2


@compiled
def frame_was_rejected(c: TickFacts) -> bool:
    """Detect a newest frame that was rejected."""
    return has_frame(c) and c.watch.rejected > 0


@compiled
def frames_are_rejected(c: TickFacts) -> bool:
    """Return True if so many frames in a row were rejected that the tool stops."""
    return has_frame(c) and c.watch.rejected >= c.thresholds.rejected


@compiled
def markers_changed_places(c: TickFacts) -> bool:
    """Return True if each marker appears at the other's place."""
    return frames_are_rejected(c) and c.watch.swapped >= c.thresholds.rejected


@compiled
def markers_are_swapped(c: TickFacts) -> bool:
    """Detect markers that changed places, or that an exploration finds in reverse order."""
    return markers_changed_places(c) or markers_stand_in_reverse(c)


@compiled
def camera_moved(c: TickFacts) -> bool:
    """Detect that both markers jumped, or that frames are rejected for good."""
    w, t = c.watch, c.thresholds
    jumped = w.jumped >= t.rejected or w.rejected >= t.rejected_for_good
    return frames_are_rejected(c) and jumped and not markers_changed_places(c)


@compiled
def markers_are_unexpected(c: TickFacts) -> bool:
    """Detect markers that no motion of tool or camera explains: by leaps, or by the drift of one
    alone.
    """
    unexplained = not (camera_moved(c) or markers_changed_places(c))
    return (frames_are_rejected(c) and unexplained) or one_marker_deviates(c)
