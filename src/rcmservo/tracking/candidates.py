"""Candidate balls of an image, and the marker pair that the tracker selects from them."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rcmservo.interfaces import FailureExplainer, Floats, Frame, Image, Tracker
from rcmservo.tracking.appearance import MIN_RADIUS_RATIO, MarkerAppearance
from rcmservo.tracking.ball_fit import Ball
from rcmservo.tracking.colour_markers import ColourMarkers
from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.local_search import detect_balls

NO_BALL_MESSAGE = "the picture shows no ball of a colour that the tracker knows"


@dataclass(frozen=True, eq=False)
class Candidate:
    """Ball of an image with the colour that shows it best.

    Parameters
    ----------
    colour : str
        One of `COLOURS`.
    ball : Ball
        Position, size and quality.
    """

    colour: str
    ball: Ball


@dataclass(frozen=True, eq=False)
class TrackedPair:
    """Markers that a tracker finds in one image.

    Parameters
    ----------
    appearance : MarkerAppearance or None
        Appearance of the markers; None for a user-defined tracker.
    points : Floats
        Markers 1 and 2, (2, 2) px; NaN for a marker that is not found.
    radius : Floats
        Radii of the markers in the image, (2,) px.
    reason : str
        Reason why the tracker does not find both markers, a sentence; empty if it does.
    """

    appearance: MarkerAppearance | None
    points: Floats
    radius: Floats
    reason: str


def detect_candidates(image: Image) -> list[Candidate]:
    """Return the balls of an image, best quality first.

    A detection by brightness counts only if no colour detects the same ball.
    """
    found: list[Candidate] = []
    for colour in COLOURS:
        for ball in detect_balls(image, COLOURS.index(colour)):
            same = [other for other in found if other.ball.is_same(ball)]
            if any(other.ball.quality >= ball.quality or colour == "bright" for other in same):
                continue
            found = [other for other in found if other not in same] + [Candidate(colour, ball)]
    return sorted(found, key=lambda candidate: -candidate.ball.quality)


def track_pair(
    image: Image, appearance: MarkerAppearance | None, tracker: Tracker | None = None
) -> TrackedPair:
    """Return the markers that `tracker` finds, by default that for a given appearance."""
    tracker, frame = tracker or ColourMarkers(appearance), Frame(0, 0, 0, image)
    markers = tracker.find(frame)
    reason = tracker.explain_failure(frame) if isinstance(tracker, FailureExplainer) else ""
    if not reason and not np.isfinite(markers.points).all():
        reason = "the tracker does not find both markers"
    return TrackedPair(appearance, markers.points, markers.radius, reason)


def measure_appearance(
    image: Image, colours: tuple[str, str], radius_1: float
) -> MarkerAppearance | None:
    """Return the appearance of markers of two different colours, measured in an image.

    `radius_1` is the radius of marker 1 in mm. None if the image does not show a ball of each
    colour.
    """
    best = [detect_balls(image, COLOURS.index(colour))[:1] for colour in colours]
    if not all(best):
        return None
    ratio = best[1][0].radius / best[0][0].radius
    return MarkerAppearance(*colours, radius_1, round(radius_1 * ratio, 2))


def propose_pair(image: Image, found: list[Candidate], radius_1: float) -> TrackedPair | None:
    """Return the best pair of candidates that the tracker can find as markers, or None.

    Pairs of two colours precede pairs of one colour. No image shows which ball is nearer the RCM,
    so the order of the two is a guess.
    """
    for appearance in _list_appearances(image, found, radius_1):
        pair = track_pair(image, appearance)
        if not pair.reason:
            return pair
    return None


def _list_appearances(
    image: Image, found: list[Candidate], radius_1: float
) -> Iterator[MarkerAppearance]:
    pairs = list(combinations(found, 2))
    for colours in dict.fromkeys((a.colour, b.colour) for a, b in pairs if a.colour != b.colour):
        appearance = measure_appearance(image, colours, radius_1)
        if appearance is not None:
            yield appearance
    for a, b in pairs:
        ratio = b.ball.radius / a.ball.radius
        if a.colour == b.colour and max(ratio, 1.0 / ratio) > MIN_RADIUS_RATIO:
            yield MarkerAppearance(a.colour, b.colour, radius_1, radius_1 * ratio)
