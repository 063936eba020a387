"""Which balls in a picture are the markers, where that is plain. Two answers are none."""

from collections.abc import Sequence

from rcmservo.tracking.ball import Ball
from rcmservo.tracking.look import MarkerLook

Both = tuple[Ball, Ball]

CLEARLY = 0.5
"""A pair whose quality is less than this share of the best one's is no rival of it."""

NEARER = 0.4
"""The nearest of several candidates is taken if it is so many times as far as the next, or less."""

AROUND = 3.0
"""Radii from where a marker was expected within which the nearest candidate may be taken."""


def rivals(look: MarkerLook, first: Sequence[Ball], second: Sequence[Ball]) -> list[Both]:
    """The pairs of balls that can be markers 1 and 2, best first, without those clearly worse."""
    pairs = [(a, b) for a in first for b in second if look.fits(a, b)]
    pairs.sort(key=lambda pair: -_quality(pair))
    return [pair for pair in pairs if _quality(pair) > CLEARLY * _quality(pairs[0])]


def plain(balls: Sequence[Ball]) -> Ball | None:
    """The best ball, if no other is a rival of it."""
    best = sorted(balls, key=lambda ball: -ball.quality)
    if len(best) == 1 or (best and best[1].quality <= CLEARLY * best[0].quality):
        return best[0]
    return None


def nearest(balls: Sequence[Ball], expected: Ball) -> Ball | None:
    """The one that is clearly nearer than the others to where a ball was expected."""
    ways = sorted(((expected.distance(ball), k) for k, ball in enumerate(balls)))
    (way, k), *others = ways
    near = way < AROUND * expected.radius and all(way <= NEARER * other for other, _ in others)
    return balls[k] if near else None


def _quality(pair: Both) -> float:
    return pair[0].quality + pair[1].quality
