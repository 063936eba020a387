"""From a picture to the two markers: where they were, where they are, and which one is which."""

from dataclasses import replace
from typing import cast, final

import numpy as np

from rcmservo.errors import require
from rcmservo.interfaces import Floats, Frame, Image, Markers
from rcmservo.tracking.ball import Ball, prepare_smeared
from rcmservo.tracking.choice import Both, nearest, plain, rivals
from rcmservo.tracking.close import ball_followed, balls_seen
from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.look import MarkerLook
from rcmservo.tracking.unseen import why_unseen

LONGEST = 3.0
"""Frames for which a motion is expected to go on as it went in one."""

Pair = tuple[Ball | None, Ball | None]
NOTHING: Pair = (None, None)


@final
class ColourMarkers:
    """Two coloured balls on the shaft, followed from frame to frame: each is expected to go on as
    it went.

    A lost one is looked for in the whole picture. It stays lost where several balls can be it.
    """

    def __init__(self, look: MarkerLook | None = None) -> None:
        require(isinstance(cast(object, look), MarkerLook | None), "look", look, "a MarkerLook")
        self.look = look or MarkerLook()
        self._colours = COLOURS.index(self.look.colour_1), COLOURS.index(self.look.colour_2)
        self.reset()

    def reset(self) -> None:
        self._last = self._before = self._remembered = NOTHING
        self._times = (0, 0)

    def find(self, frame: Frame) -> Markers:
        prepare_smeared()
        image = _picture(frame)
        expected = self._expected(frame.exposure)
        pair = self._follow(image, expected)
        if pair[0] is None or pair[1] is None:
            pair = self._as_large(self._search(image, pair))
        self._before, self._last = self._last, pair
        self._remembered = pair[0] or self._remembered[0], pair[1] or self._remembered[1]
        self._times = self._times[1], frame.exposure
        return _markers(pair)

    def why(self, frame: Frame) -> str:
        """Why the markers are not found in a frame; empty where they are. It takes its time."""
        return why_unseen(_picture(frame), self.look)

    def _expected(self, now: int) -> Pair:
        """Where the markers are if they went on as they did between the last two frames; one that
        was seen in the last alone, as the other did."""
        before, last = self._times
        share = (now - last) / (last - before) if last > before else 0.0
        share = min(max(share, 0.0), LONGEST)
        ways = [
            (share * (b.u - a.u), share * (b.v - a.v)) if a and b else None
            for a, b in zip(self._before, self._last, strict=True)
        ]
        first, second = (
            ball.moved(*way) if ball and way else ball
            for ball, way in zip(self._last, (ways[0] or ways[1], ways[1] or ways[0]), strict=True)
        )
        return first, second

    def _follow(self, image: Image, expected: Pair) -> Pair:
        """The markers near where they are expected, or else where they were. Of two that look alike
        both or none: one alone might be the other."""
        first, second = (
            _followed(image, c, there, last)
            for c, there, last in zip(self._colours, expected, self._last, strict=True)
        )
        if self.look.alike and not _continued(expected, (first, second)):
            return None, None
        return first, second

    def _search(self, image: Image, followed: Pair) -> Pair:
        """The followed ones as they are, and the missing ones from the whole picture."""
        missing = {c for c, ball in zip(self._colours, followed, strict=True) if ball is None}
        everywhere = {c: balls_seen(image, c) for c in missing}
        first, second = (
            [ball] if ball else everywhere[c]
            for c, ball in zip(self._colours, followed, strict=True)
        )
        pairs = rivals(self.look, first, second)
        if len(pairs) == 1:
            return pairs[0]
        if pairs:
            return self._remembered_one(pairs, followed)
        if self.look.alike or (first and second):
            return followed
        return plain(first), plain(second)

    def _as_large(self, pair: Pair) -> Pair:
        """The markers; one that only the search has found, and may be smeared, is as large as it
        was before."""
        first, second = (
            replace(ball, radius=memory.radius)
            if ball and memory and np.isnan(ball.covariance).any()
            else ball
            for ball, memory in zip(pair, self._remembered, strict=True)
        )
        return first, second

    def _remembered_one(self, pairs: list[Both], followed: Pair) -> Pair:
        """Of several pairs that can be the markers, that with the followed one in which the other
        is clearly nearest to where it was seen last; else only what is followed."""
        for k, (lost, memory) in enumerate(zip(followed, self._remembered, strict=True)):
            if lost is None and memory and followed[1 - k]:
                one = nearest([pair[k] for pair in pairs], memory)
                return (one, followed[1]) if k == 0 else (followed[0], one)
        return followed


def _picture(frame: Frame) -> Image:
    """The frame's picture, if it is one to look for coloured markers in."""
    image = frame.image
    right = "a (height, width, 3) uint8 picture to look for coloured markers in"
    good = image is not None and image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8
    require(good, "frame.image", None if image is None else (image.shape, str(image.dtype)), right)
    assert image is not None
    return image


def _followed(image: Image, colour: int, there: Ball | None, last: Ball | None) -> Ball | None:
    """A marker where it is expected, or else where it was, or where it is if it turned back."""
    if there is None or last is None:
        return None
    way = there.u - last.u, there.v - last.v
    places = [there] if there is last else [there, last, last.moved(-way[0], -way[1])]
    looks = (ball_followed(image, colour, place, way) for place in places)
    return next((ball for ball in looks if ball), None)


def _continued(before: Pair, now: Pair) -> bool:
    """Whether two markers that look alike kept apart, each far from where the other was."""
    (a0, b0), (a, b) = before, now
    if a0 is None or b0 is None or a is None or b is None:
        return False
    farthest = max(a.distance(a0), b.distance(b0))
    return a.distance(b) > 0.5 * (a.radius + b.radius) and farthest < 0.35 * a0.distance(b0)


def _markers(pair: Pair) -> Markers:
    points, radius, quality = np.full((2, 2), np.nan), np.full(2, np.nan), np.zeros(2)
    covariance = np.full((2, 3, 3), np.nan)
    for i, ball in enumerate(pair):
        if ball is not None:
            points[i], radius[i], quality[i] = (ball.u, ball.v), ball.radius, ball.quality
            covariance[i] = ball.covariance
    return Markers(points, radius, quality, covariance)


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
