"""Which balls of a picture could be markers, and which two the tracker takes."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rcmservo.interfaces import Floats, Frame, Image
from rcmservo.tracking.ball import Ball
from rcmservo.tracking.close import balls_seen
from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.look import APART, MarkerLook
from rcmservo.tracking.markers import ColourMarkers

SAME = 0.7
"""Of the larger radius: balls nearer to each other are one, seen by several colours."""

UNSEEN = "the picture shows no ball of a colour that the tracker knows"


@dataclass(frozen=True, eq=False)
class Candidate:
    """A ball of a picture, by the colour that shows it best."""

    colour: str
    """One of COLOURS."""
    ball: Ball
    """Where it is, how large, and how well it is seen."""


@dataclass(frozen=True, eq=False)
class TakenPair:
    """What the tracker makes of a picture, of markers that look like this."""

    look: MarkerLook
    """How the markers are to look."""
    points: Floats
    """Markers 1 and 2 (2, 2) px; NaN for one that is not found."""
    radius: Floats
    """Theirs (2,) px."""
    why: str
    """Why it does not take two, in a sentence; empty where it does."""


def candidates(image: Image) -> list[Candidate]:
    """The balls of a picture, best seen first. Brightness counts where no colour shows a ball."""
    found: list[Candidate] = []
    for colour in COLOURS:
        for ball in balls_seen(image, COLOURS.index(colour)):
            same = [one for one in found if _same(one.ball, ball)]
            if any(one.ball.quality >= ball.quality or colour == "bright" for one in same):
                continue
            found = [one for one in found if one not in same] + [Candidate(colour, ball)]
    return sorted(found, key=lambda one: -one.ball.quality)


def taken(image: Image, look: MarkerLook) -> TakenPair:
    """What the tracker takes for markers that look like this."""
    tracker, frame = ColourMarkers(look), Frame(0, 0, 0, image)
    seen, why = tracker.find(frame), tracker.why(frame)
    if not why and not np.isfinite(seen.points).all():
        why = "the tracker does not find both markers"
    return TakenPair(look, seen.points, seen.radius, why)


def chosen(image: Image, colours: tuple[str, str], first: float) -> MarkerLook | None:
    """How markers of these two different colours look in a picture, the first `first` mm in radius;
    None where it does not show both."""
    best = [balls_seen(image, COLOURS.index(colour))[:1] for colour in colours]
    if not all(best):
        return None
    ratio = best[1][0].radius / best[0][0].radius
    return MarkerLook(*colours, first, round(first * ratio, 2))


def proposed(image: Image, found: list[Candidate], first: float) -> TakenPair | None:
    """The best seen pair that the tracker would take, as of markers of its colours; of two colours
    before one. Which of them is nearer the RCM no picture tells."""
    for look in _looks(image, found, first):
        pair = taken(image, look)
        if not pair.why:
            return pair
    return None


def _looks(image: Image, found: list[Candidate], first: float) -> Iterator[MarkerLook]:
    pairs = list(combinations(found, 2))
    for colours in dict.fromkeys((a.colour, b.colour) for a, b in pairs if a.colour != b.colour):
        look = chosen(image, colours, first)
        if look is not None:
            yield look
    for a, b in pairs:
        ratio = b.ball.radius / a.ball.radius
        if a.colour == b.colour and max(ratio, 1.0 / ratio) > APART:
            yield MarkerLook(a.colour, b.colour, first, first * ratio)


def _same(a: Ball, b: Ball) -> bool:
    return a.distance(b) < SAME * max(a.radius, b.radius)
