"""Local search: fit of a ball near its expected position.

The same fit confirms the balls that the full search proposes.
"""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Image
from rcmservo.tracking.ball_fit import Ball, fit_ball, fit_blurred_ball
from rcmservo.tracking.colours import compute_colour_response
from rcmservo.tracking.full_search import find_balls, merge_ball

MAX_OFFSET_RADII = 0.75
"""Largest distance from the expected position, in radii, at which a marker is followed. Beyond it
the tracker searches the whole image."""

MAX_RADIUS_RATIO = 1.25
"""Largest change of the radius between two frames at which a marker is followed."""

BLUR_CHECK_RADII = 0.3
"""Motion per frame, in radii, above which the tracker also fits a motion-blurred ball."""
BLUR_FALLBACK_RADII = 0.15
"""Motion per frame, in radii, above which the tracker fits a motion-blurred ball if the sharp fit
fails."""

MAX_BLUR_RADII = 6.0
"""Motion per frame, in radii, above which a marker has jumped: no exposure blurs it so far."""

MOTION_CHANGE_RATIO = 0.5
"""Change of the motion from frame to frame that is expected of a fast marker, as a fraction."""

BORDER_RADIUS_FACTOR = 1.5
"""Factor on the radius that keeps a ball without a confirmed fit clear of the border."""

MIN_QUALITY_RATIO = 0.75
"""Smallest ratio of the sharp and the blurred fit's quality at which the sharp fit is used."""
BLUR_SHIFT_RATIO = 0.04
"""Standard deviation of a sharp fit's shift by blur, as a fraction of the motion."""

Motion = tuple[float, float]
"""Motion (du, dv) of a marker between two frames (px)."""


def follow_ball(image: Image, colour: int, last: Ball, motion: Motion) -> Ball | None:
    """Return the marker near its expected position `last`, or None.

    None means that it is too far from there, that its radius changed too much or that it touches
    the border of the image. A fast marker may be blurred by up to its `motion`: the exposure time
    is unknown. The sharp fit is used if it is about as good as the blurred fit. A blurred ball
    keeps its previous radius, because a fitted radius would drift from frame to frame.
    """
    sharp = _accept_near(_fit_in_window(image, colour, last, None), last)
    motion_px = float(np.hypot(*motion))
    min_blur_px = (BLUR_CHECK_RADII if sharp else BLUR_FALLBACK_RADII) * last.radius
    if not min_blur_px < motion_px <= MAX_BLUR_RADII * last.radius:
        return sharp
    blurred = _fit_in_window(image, colour, last, motion)
    blurred = _accept_near(blurred, last, MOTION_CHANGE_RATIO * motion_px)
    if sharp and not (blurred and sharp.quality < MIN_QUALITY_RATIO * blurred.quality):
        shift_covariance = (BLUR_SHIFT_RATIO * motion_px) ** 2 * np.diag([1.0, 1.0, 0.0])
        return replace(sharp, covariance=sharp.covariance + shift_covariance)
    return replace(blurred, radius=last.radius) if blurred else None


def detect_balls(image: Image, colour: int) -> list[Ball]:
    """Return every ball that a fit confirms, best quality first.

    If no fit confirms a ball, the balls may be blurred by motion; then the proposals of the full
    search are returned.
    """
    confirmed: list[Ball] = []
    proposals = find_balls(compute_colour_response(np.array(image), colour))
    for proposed in proposals:
        ball = _fit_in_window(image, colour, proposed, None)
        if ball:
            confirmed = merge_ball(confirmed, ball)
    confirmed.sort(key=lambda ball: -ball.quality)
    return confirmed or [ball for ball in proposals if _is_usable(image, ball)]


def _is_usable(image: Image, ball: Ball) -> bool:
    """Report whether a proposed ball has enough outline and lies clear of the border.

    The border cuts off a part of a ball and so reduces its radius and shifts its centre; the test
    therefore enlarges the radius.
    """
    height, width = image.shape[:2]
    whole = replace(ball, radius=BORDER_RADIUS_FACTOR * ball.radius).is_within(width, height)
    return whole and ball.has_enough_outline


def _fit_in_window(image: Image, colour: int, last: Ball, motion: Motion | None) -> Ball | None:
    """Return the ball near `last` if the image contains it; with a `motion`, a blurred ball."""
    height, width = image.shape[:2]
    reach = 2.2 * last.radius + 8.0 + (float(np.hypot(*motion)) if motion else 0.0)
    left, top = max(int(last.u - reach), 0), max(int(last.v - reach), 0)
    window = np.array(image[top : int(last.v + reach) + 1, left : int(last.u + reach) + 1])
    if min(window.shape) == 0:
        return None
    expected = last.shift(-left, -top)
    if motion:
        fitted = fit_blurred_ball(window, colour, expected, motion)
    else:
        fitted = fit_ball(window, colour, expected.u, expected.v, expected.radius)
    ball = fitted.shift(left, top) if fitted else None
    return ball if ball and ball.is_within(width, height) else None


def _accept_near(ball: Ball | None, last: Ball, tolerance: float = 0.0) -> Ball | None:
    """Return the ball if it is near its expected position and of about the same radius.

    `tolerance` (px) adds to the usual distance.
    """
    if ball is None or ball.distance_to(last) > MAX_OFFSET_RADII * last.radius + tolerance:
        return None
    return ball if 1.0 / MAX_RADIUS_RATIO < ball.radius / last.radius < MAX_RADIUS_RATIO else None
