"""The close look: a ball near a place where it is expected, and every ball of a picture."""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Image
from rcmservo.tracking.ball import Ball, ball_near, smeared_ball
from rcmservo.tracking.colours import weights
from rcmservo.tracking.search import balls, without_worse

JUMP = 0.75
"""Of its radius: a marker that moved further between two frames is looked for afresh."""

SWELL = 1.25
"""A marker whose radius changed by more than this factor is looked for afresh."""

FAST = 0.3
"""Of its radius: a marker that moves further in a frame may be smeared by its motion,"""
SURELY = 0.15
"""and one that no sharp look finds, if it moves so far."""

JUMPS = 6.0
"""Of its radius: one that moves further has jumped, and no exposure smears it so far."""

GAIN = 0.5
"""Of its way, by which the next one of a fast marker may differ."""

DOUBT = 1.5
"""Times its radius that a ball may have which only the search has found."""

AS_GOOD = 0.75
"""Of the smeared ball's quality. The sharp one is taken if it has so much,"""
SHIFTED = 0.04
"""and may be off by so much of its way: one standard deviation."""

Way = tuple[float, float]
"""px that a marker moves between two frames."""


def ball_followed(image: Image, colour: int, last: Ball, way: Way) -> Ball | None:
    """The marker about a place where it is expected. None if it is far from there, swelled or
    touches the picture's border.

    One that is fast may be smeared, by up to its `way`: how long the camera exposes is not known.
    The sharp look counts where the outline supports it about as well. A smeared one keeps the
    radius it had, which would drift from frame to frame.
    """
    sharp, speed = _steady(_looked(image, colour, last, None), last), float(np.hypot(*way))
    if not (FAST if sharp else SURELY) * last.radius < speed <= JUMPS * last.radius:
        return sharp
    smeared = _steady(_looked(image, colour, last, way), last, GAIN * speed)
    if sharp and not (smeared and sharp.quality < AS_GOOD * smeared.quality):
        shift = (SHIFTED * speed) ** 2 * np.diag([1.0, 1.0, 0.0])
        return replace(sharp, covariance=sharp.covariance + shift)
    return replace(smeared, radius=last.radius) if smeared else None


def balls_seen(image: Image, colour: int) -> list[Ball]:
    """Every ball that a close look confirms, best seen first; if it confirms none, as of balls that
    a motion smears, those that the search has found."""
    found: list[Ball] = []
    proposals = balls(weights(np.array(image), colour))
    for proposed in proposals:
        ball = _looked(image, colour, proposed, None)
        if ball:
            found = without_worse(found, ball)
    found = sorted(found, key=lambda ball: -ball.quality)
    return found or [ball for ball in proposals if _clear(image, ball)]


def _clear(image: Image, ball: Ball) -> bool:
    """Whether enough is seen of a ball that only the search has found, and it is clear of the
    picture's border however large it is: one that is cut there seems smaller, and elsewhere."""
    height, width = image.shape[:2]
    whole = replace(ball, radius=DOUBT * ball.radius).within(width, height)
    return whole and ball.fixed


def _looked(image: Image, colour: int, last: Ball, way: Way | None) -> Ball | None:
    """The ball about a place, if it is whole in the picture; with a `way`, one that is smeared."""
    height, width = image.shape[:2]
    reach = 2.2 * last.radius + 8.0 + (float(np.hypot(*way)) if way else 0.0)
    left, top = max(int(last.u - reach), 0), max(int(last.v - reach), 0)
    window = np.array(image[top : int(last.v + reach) + 1, left : int(last.u + reach) + 1])
    if min(window.shape) == 0:
        return None
    there = last.moved(-left, -top)
    if way:
        seen = smeared_ball(window, colour, there, way)
    else:
        seen = ball_near(window, colour, there.u, there.v, there.radius)
    ball = seen.moved(left, top) if seen else None
    return ball if ball and ball.within(width, height) else None


def _steady(ball: Ball | None, last: Ball, more: float = 0.0) -> Ball | None:
    """The ball, if it is about where it was expected, `more` px off beside what is usual, and as
    large."""
    if ball is None or ball.distance(last) > JUMP * last.radius + more:
        return None
    return ball if 1.0 / SWELL < ball.radius / last.radius < SWELL else None
