"""Contract of a tracker: markers where they are, NaN where there is none, and nothing else."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rcmservo.errors import BadInput
from rcmservo.interfaces import Floats, Frame, Markers, Tracker
from rcmservo.testing.violations import ContractViolation, WatchedPart

FRAME_PERIOD_NS = 16_666_667
"""Time in ns between two frames of the check."""


def check_tracker(
    tracker: Tracker, frame: Frame, points: ArrayLike, *, tolerance: float = 2.0
) -> None:
    """Check a tracker against its contract with one frame and an empty one.

    The empty frame is the given one in its median colour. A tracker that looks for structure in a
    uniform image must find none.

    Parameters
    ----------
    tracker : Tracker
        Tracker of the user.
    frame : Frame
        Frame that shows both markers.
    points : ArrayLike
        Markers (2, 2) in px in this frame, as (u, v). Row 0 is the marker nearer the RCM.
    tolerance : float
        Largest error of a marker in px; 2 by default.

    Raises
    ------
    ContractViolation
        With the first violation in one sentence: arrays of another shape or type, swapped rows, a
        wrong position, a guess for an absent marker, a radius or quality outside its range, a
        changed frame or earlier result, a result that `reset` does not restore, or a damaged frame
        that is not refused.
    """
    part, expected = WatchedPart(tracker), np.asarray(points, dtype=np.float64)
    empty, damaged = _make_empty(frame), replace(frame, image=None, points=None)
    part.call("reset")
    _require_absent(part, _find(part, empty))
    part.call("reset")
    markers = _find(part, frame)
    _require_position(part, markers, expected, tolerance)
    before = [array.copy() for array in _arrays(markers)]
    later = replace(empty, number=frame.number + 1, exposure=frame.exposure + FRAME_PERIOD_NS)
    _require_absent(part, _find(part, later))
    is_unchanged = _are_equal(before, _arrays(markers))
    finding = "overwrote the arrays of an earlier result, expected new arrays for each frame"
    part.require(is_unchanged, "find", finding)
    part.call("reset")
    is_restored = _are_equal(before, _arrays(_find(part, frame)))
    finding = "leaves a state: the same frame gives another result after it"
    part.require(is_restored, "reset", finding)
    _require_refused(part, damaged)


def _find(part: WatchedPart, frame: Frame) -> Markers:
    """Return the markers of a frame if they have the form that the contract states."""
    image, points = _copy(frame.image), _copy(frame.points)
    markers: Markers = part.call_checked("find", frame)
    is_unchanged = _are_equal([image, points], [frame.image, frame.points])
    part.require(is_unchanged, "find", "changed the frame in place, expected it unchanged")
    quality = np.asarray(markers.quality, dtype=np.float64)
    is_valid = quality.shape == (2,) and bool(((quality >= 0.0) & (quality <= 1.0)).all())
    finding = f"returned the quality {markers.quality}, expected two numbers from 0 to 1"
    part.require(is_valid, "find", finding)
    finding = f"returned the radius {markers.radius}, expected px above 0, or NaN if unknown"
    is_valid = bool((np.isnan(markers.radius) | (markers.radius > 0.0)).all())
    part.require(is_valid, "find", finding)
    shape = np.shape(markers.covariance)
    finding = f"returned a covariance of shape {shape}, expected (2, 3, 3)"
    part.require(shape == (2, 3, 3), "find", finding)
    return markers


def _require_position(
    part: WatchedPart, markers: Markers, expected: Floats, tolerance: float
) -> None:
    found = markers.points
    finding = f"returned the rows in swapped order: {found.tolist()}, row 0 is nearer the RCM"
    errors, swapped = (np.abs(found - e).max(initial=0.0) for e in (expected, expected[::-1]))
    part.require(not swapped <= tolerance, "find", finding)
    finding = f"returned {found.tolist()} px, expected {expected.tolist()} within {tolerance:g} px"
    part.require(bool(errors <= tolerance), "find", finding)


def _require_absent(part: WatchedPart, markers: Markers) -> None:
    """Raise the violation if a tracker reports something about markers that are not there."""
    finding = f"returned {markers.points.tolist()} for an empty image, expected NaN, not a guess"
    part.require(bool(np.isnan(markers.points).all()), "find", finding)
    finding = f"returned the radius {markers.radius} of absent markers, expected NaN"
    part.require(bool(np.isnan(markers.radius).all()), "find", finding)


def _require_refused(part: WatchedPart, damaged: Frame) -> None:
    """Raise the violation unless a damaged frame raises `BadInput`."""
    try:
        part.call("find", damaged)
    except ContractViolation as error:
        if isinstance(error.__cause__, BadInput):
            return
        raise ContractViolation(f"{error} for a damaged frame, expected BadInput") from error
    part.fail("find", "accepted a frame without image and points, expected BadInput")


def _make_empty(frame: Frame) -> Frame:
    """Return the frame without markers: an image in its median colour, or points that are NaN."""
    image = None if frame.image is None else np.empty_like(frame.image)
    if frame.image is not None and image is not None:
        image[:] = np.median(frame.image.reshape(-1, 3), axis=0)
    points = None if frame.points is None else np.full((2, 2), np.nan)
    return replace(frame, image=image, points=points)


def _arrays(markers: Markers) -> list[Any]:
    return [markers.points, markers.radius, np.asarray(markers.quality), markers.covariance]


def _copy(array: Any) -> Any:
    return None if array is None else array.copy()


def _are_equal(before: list[Any], after: list[Any]) -> bool:
    """Return True if arrays have the same bytes; None equals None."""
    pairs = zip(before, after, strict=True)
    return all(a is b or (a is not None and a.tobytes() == b.tobytes()) for a, b in pairs)
