"""From a picture to the two markers: where they were, where they are, and which one is which."""

from typing import final

import numpy as np

from rcmservo.errors import require
from rcmservo.interfaces import Floats, Frame, Image, Markers
from rcmservo.tracking.ball import Ball, ball_near
from rcmservo.tracking.colours import COLOURS, weights
from rcmservo.tracking.look import MarkerLook
from rcmservo.tracking.search import balls
from rcmservo.tracking.unseen import why_unseen

JUMP = 0.75
"""Of its radius: a marker that moved further between two frames is looked for afresh."""

SWELL = 1.25
"""A marker whose radius changed by more than this factor is looked for afresh."""

Pair = tuple[Ball | None, Ball | None]


@final
class ColourMarkers:
    """Two coloured balls on the shaft, followed from frame to frame.

    A lost one is looked for in the whole picture.
    """

    def __init__(self, look: MarkerLook | None = None) -> None:
        self.look = look or MarkerLook()
        self._colours = COLOURS.index(self.look.colour_1), COLOURS.index(self.look.colour_2)
        self._last: Pair = (None, None)

    def reset(self) -> None:
        self._last = (None, None)

    def find(self, frame: Frame) -> Markers:
        image = _picture(frame)
        pair = self._follow(image)
        if pair[0] is None or pair[1] is None:
            pair = self._search(image, pair)
        self._last = pair
        return _markers(pair)

    def why(self, frame: Frame) -> str:
        """Why the markers are not found in a frame; empty where they are. It takes its time."""
        return why_unseen(_picture(frame), self.look)

    def _follow(self, image: Image) -> Pair:
        """The markers near where they were. Of two that look alike both or none: one alone might
        be the other."""
        first, second = (
            _near(image, c, ball) for c, ball in zip(self._colours, self._last, strict=True)
        )
        if self.look.alike and not _continued(self._last, (first, second)):
            return None, None
        return first, second

    def _search(self, image: Image, followed: Pair) -> Pair:
        """The followed ones as they are, and the missing ones from the whole picture."""
        found = [[ball] if ball else [] for ball in followed]
        for colour in dict.fromkeys(
            c for c, some in zip(self._colours, found, strict=True) if not some
        ):
            everywhere = balls(weights(np.array(image), colour))
            for some, c in zip(found, self._colours, strict=True):
                if c == colour and not some:
                    some.extend(everywhere)
        pairs = [(a, b) for a in found[0] for b in found[1] if self.look.fits(a, b)]
        if pairs:
            return max(pairs, key=lambda pair: pair[0].quality + pair[1].quality)
        if self.look.alike or (found[0] and found[1]):
            return followed
        return (found[0] or [None])[0], (found[1] or [None])[0]


def _picture(frame: Frame) -> Image:
    """The frame's picture, if it is one to look for coloured markers in."""
    image = frame.image
    right = "a (height, width, 3) uint8 picture to look for coloured markers in"
    good = image is not None and image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8
    require(good, "frame.image", None if image is None else (image.shape, str(image.dtype)), right)
    assert image is not None
    return image


def _near(image: Image, colour: int, last: Ball | None) -> Ball | None:
    """The marker about its last place. None if it jumped, swelled or touches the picture's
    border."""
    if last is None:
        return None
    height, width = image.shape[:2]
    reach = 2.2 * last.radius + 8.0
    left, top = max(int(last.u - reach), 0), max(int(last.v - reach), 0)
    window = np.array(image[top : int(last.v + reach) + 1, left : int(last.u + reach) + 1])
    if min(window.shape) == 0:
        return None
    seen = ball_near(weights(window, colour), last.u - left, last.v - top, last.radius)
    if seen is None:
        return None
    ball = Ball(seen.u + left, seen.v + top, seen.radius, seen.quality)
    steady = (
        ball.distance(last) <= JUMP * last.radius
        and 1.0 / SWELL < ball.radius / last.radius < SWELL
    )
    return ball if steady and ball.within(width, height) else None


def _continued(before: Pair, now: Pair) -> bool:
    """Whether two markers that look alike kept apart, each far from where the other was."""
    (a0, b0), (a, b) = before, now
    if a0 is None or b0 is None or a is None or b is None:
        return False
    farthest = max(a.distance(a0), b.distance(b0))
    return a.distance(b) > 0.5 * (a.radius + b.radius) and farthest < 0.35 * a0.distance(b0)


def _markers(pair: Pair) -> Markers:
    points, radius, quality = np.full((2, 2), np.nan), np.full(2, np.nan), np.zeros(2)
    for i, ball in enumerate(pair):
        if ball is not None:
            points[i], radius[i], quality[i] = (ball.u, ball.v), ball.radius, ball.quality
    return Markers(points, radius, quality)


@final
class PointMarkers:
    """The markers of a camera that delivers their centres instead of pictures."""

    def reset(self) -> None:
        pass

    def find(self, frame: Frame) -> Markers:
        points: Floats = np.array(frame.points, dtype=np.float64)
        require(
            points.shape == (2, 2),
            "frame.points",
            frame.points,
            "the two markers' centres, (2, 2) px",
        )
        seen = np.isfinite(points).all(axis=1)
        points[~seen] = np.nan
        return Markers(points, np.full(2, np.nan), np.where(seen, 1.0, 0.0))

    def why(self, frame: Frame) -> str:
        """Which markers the camera does not tell."""
        lost = [f"marker {i}" for i, q in enumerate(self.find(frame).quality, 1) if not q]
        return f"the camera does not see {' and '.join(lost)}" if lost else ""
