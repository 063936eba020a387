"""Selection of the two markers among the balls of an image, where it is unambiguous."""

from collections.abc import Sequence

from rcmservo.tracking.appearance import MarkerAppearance
from rcmservo.tracking.ball_fit import Ball

BallPair = tuple[Ball, Ball]

MAX_RIVAL_QUALITY_RATIO = 0.5
"""Quality relative to the best, up to which a ball or pair is no rival of the best."""

MAX_DISTANCE_RATIO = 0.4
"""Largest ratio of the distances of the nearest and the second nearest candidate."""

MAX_DISTANCE_RADII = 3.0
"""Largest distance of the nearest candidate from the expected position, in radii."""


def find_candidate_pairs(
    appearance: MarkerAppearance, first: Sequence[Ball], second: Sequence[Ball]
) -> list[BallPair]:
    """Return the pairs of balls that can be markers 1 and 2, best first.

    Pairs of clearly worse quality are left out.
    """
    pairs = [(a, b) for a in first for b in second if appearance.matches_sizes(a, b)]
    pairs.sort(key=lambda pair: -_quality(pair))
    return [pair for pair in pairs if _quality(pair) > MAX_RIVAL_QUALITY_RATIO * _quality(pairs[0])]


def choose_unrivalled(balls: Sequence[Ball]) -> Ball | None:
    """Return the best ball if no other ball rivals it, or None."""
    best = sorted(balls, key=lambda ball: -ball.quality)
    if len(best) == 1 or (best and best[1].quality <= MAX_RIVAL_QUALITY_RATIO * best[0].quality):
        return best[0]
    return None


def choose_nearest(balls: Sequence[Ball], expected: Ball) -> Ball | None:
    """Return the ball that is clearly nearest to the expected one, or None."""
    distances = sorted(((expected.distance(ball), k) for k, ball in enumerate(balls)))
    (distance, k), *others = distances
    is_nearest = distance < MAX_DISTANCE_RADII * expected.radius and all(
        distance <= MAX_DISTANCE_RATIO * other for other, _ in others
    )
    return balls[k] if is_nearest else None


def _quality(pair: BallPair) -> float:
    return pair[0].quality + pair[1].quality
