"""Marker identity: which ball of an image is marker 1 and which is marker 2.

Colours and sizes distinguish the markers, and their last positions where these are ambiguous. A
marker stays lost rather than exchange its number with another ball.
"""

from collections.abc import Sequence

from rcmservo.tracking.appearance import MarkerAppearance
from rcmservo.tracking.ball_fit import Ball

BallPair = tuple[Ball, Ball]
"""Markers 1 and 2."""
OptionalPair = tuple[Ball | None, Ball | None]
"""Markers 1 and 2; None for a lost marker."""

MAX_PERSPECTIVE_RATIO = 2.0
"""Largest ratio of the distances of both markers from the camera."""

MIN_SIZE_RATIO = 1.04
"""Smallest ratio of the radii in the image that distinguishes two markers of one colour."""

MIN_SEPARATION_RADII = 0.5
"""Smallest distance of two markers of one colour, as a fraction of the sum of their radii."""

MAX_IDENTITY_MOTION = 0.35
"""Largest motion of a marker between frames, as a fraction of the distance to the other marker, at
which two markers of one colour keep their numbers."""

MAX_RIVAL_QUALITY_RATIO = 0.5
"""Quality relative to the best, up to which a ball or pair is no rival of the best."""

MAX_DISTANCE_RATIO = 0.4
"""Largest ratio of the distances of the nearest and the second nearest candidate."""

MAX_DISTANCE_RADII = 3.0
"""Largest distance of the nearest candidate from the expected position, in radii."""


def assign_numbers(
    appearance: MarkerAppearance,
    first: Sequence[Ball],
    second: Sequence[Ball],
    followed: OptionalPair,
    last_found: OptionalPair,
) -> OptionalPair:
    """Return markers 1 and 2 among the candidates of an image.

    Parameters
    ----------
    appearance : MarkerAppearance
        Colours and sizes of the markers.
    first, second : sequence of Ball
        Balls with the colour of marker 1, and of marker 2; a followed marker is its only candidate.
    followed : tuple of Ball or None
        Markers that were followed from the frame before.
    last_found : tuple of Ball or None
        Markers where they were found last.

    Returns
    -------
    tuple of Ball or None
        The only candidate pair. If several pairs are possible, the followed marker with the lost
        one nearest to its last position; if none is, each marker by its colour alone. None for a
        marker that remains ambiguous.
    """
    pairs = find_candidate_pairs(appearance, first, second)
    if len(pairs) == 1:
        return pairs[0]
    if pairs:
        return _recover_lost(pairs, followed, last_found)
    if appearance.same_colour or (first and second):
        return followed
    return _choose_unrivalled(first), _choose_unrivalled(second)


def find_candidate_pairs(
    appearance: MarkerAppearance, first: Sequence[Ball], second: Sequence[Ball]
) -> list[BallPair]:
    """Return the pairs of balls that can be markers 1 and 2, best first.

    Pairs of clearly worse quality are left out.
    """
    pairs = [(a, b) for a in first for b in second if can_be_markers(appearance, a, b)]
    pairs.sort(key=lambda pair: -_pair_quality(pair))
    min_quality = MAX_RIVAL_QUALITY_RATIO * _pair_quality(pairs[0]) if pairs else 0.0
    return [pair for pair in pairs if _pair_quality(pair) > min_quality]


def can_be_markers(appearance: MarkerAppearance, first: Ball, second: Ball) -> bool:
    """Report whether two balls can be markers 1 and 2 by their sizes in the image.

    The test assumes that neither marker is twice as near to the camera as the other. Of two markers
    of one colour, the larger one must also look larger.
    """
    expected, ratio = appearance.ratio, first.radius / second.radius
    if not 1.0 / MAX_PERSPECTIVE_RATIO < ratio / expected < MAX_PERSPECTIVE_RATIO:
        return False
    if not appearance.same_colour:
        return True
    is_distinct = ratio > MIN_SIZE_RATIO if expected > 1.0 else ratio < 1.0 / MIN_SIZE_RATIO
    return is_distinct and _are_separate(first, second)


def have_kept_numbers(previous: OptionalPair, current: OptionalPair) -> bool:
    """Report whether each of two markers stayed far from the other's previous position."""
    (first_before, second_before), (first, second) = previous, current
    if first_before is None or second_before is None or first is None or second is None:
        return False
    motion = max(first.distance_to(first_before), second.distance_to(second_before))
    has_moved_little = motion < MAX_IDENTITY_MOTION * first_before.distance_to(second_before)
    return has_moved_little and _are_separate(first, second)


def _recover_lost(
    pairs: list[BallPair], followed: OptionalPair, last_found: OptionalPair
) -> OptionalPair:
    """Return the followed marker, with the lost one nearest to its last position.

    The lost marker stays lost if no candidate is clearly the nearest. If both are lost, both stay
    lost.
    """
    first, second = followed
    if first is None and second and last_found[0]:
        return _choose_nearest([pair[0] for pair in pairs], last_found[0]), second
    if second is None and first and last_found[1]:
        return first, _choose_nearest([pair[1] for pair in pairs], last_found[1])
    return followed


def _choose_unrivalled(balls: Sequence[Ball]) -> Ball | None:
    """Return the best ball if no other ball rivals it, or None."""
    best = sorted(balls, key=lambda ball: -ball.quality)
    if len(best) == 1 or (best and best[1].quality <= MAX_RIVAL_QUALITY_RATIO * best[0].quality):
        return best[0]
    return None


def _choose_nearest(balls: Sequence[Ball], expected: Ball) -> Ball | None:
    """Return the ball that is clearly nearest to the expected one, or None."""
    distances = sorted((expected.distance_to(ball), k) for k, ball in enumerate(balls))
    (distance, k), *others = distances
    is_nearest = distance < MAX_DISTANCE_RADII * expected.radius and all(
        distance <= MAX_DISTANCE_RATIO * other for other, _ in others
    )
    return balls[k] if is_nearest else None


def _are_separate(first: Ball, second: Ball) -> bool:
    return first.distance_to(second) > MIN_SEPARATION_RADII * (first.radius + second.radius)


def _pair_quality(pair: BallPair) -> float:
    return pair[0].quality + pair[1].quality
