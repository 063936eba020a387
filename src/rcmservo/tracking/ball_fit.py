"""Fit of one ball in an image, and the tests that accept the fitted shape as a ball."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from rcmservo.interfaces import Floats, Image
from rcmservo.numerics.jit import compiled
from rcmservo.tracking.circle_fit import (
    RAY_COS,
    RAY_COUNT,
    RAY_SIN,
    find_colour_centroid,
    fit_outline,
    measure_ray_agreement,
    measure_support,
)
from rcmservo.tracking.colours import CHANNEL_MIXES, compute_colour_response
from rcmservo.tracking.edge_fit import fit_edge
from rcmservo.tracking.motion_blur import (
    fit_blurred_outline,
    match_blurred_disc,
    render_blurred_disc,
)

MIN_RADIUS_PX = 4.0
"""Smallest accepted radius (px). On a smaller ball, half a pixel of noise looks round."""

MIN_SUPPORT = 0.45
"""Smallest observed fraction of the outline. A shorter arc determines the centre too badly."""

MIN_COARSE_SUPPORT = 0.3
"""Smallest observed fraction of the outline about the coarse ellipse. Shading shifts that ellipse
on large balls."""

MIN_SUPPORT_RATIO = 0.9
"""Smallest ratio of the support of the edge fit to that of the coarse ellipse. Pixels that motion
blurs, or that show no shaded ball, can shift the edge fit."""
MAX_CENTRE_STD_PX = 0.04
"""Largest standard deviation (px) of the centre at which the edge fit is accepted with less
support: disturbed pixels give twice this deviation, and the coarse ellipse may owe its support to
the shaft's edges."""

MIN_FILLED_FRACTION = 0.3
"""Fraction of the radius, measured from the centre, that has the ball's colour on at least
`MIN_FILLED_RAYS` rays. A crescent next to the shaft passes; a ring does not."""

MIN_FILLED_RAYS = 6
"""Smallest number of filled rays."""

SAMPLES_PER_RADIUS = 32
"""Samples along a ray from the centre to the outline."""

MIN_NOISE_SAMPLES = 1000
"""Pixel pairs used to estimate the noise; this many estimate it to 5 %."""

MIN_CONTRAST = 15.0
"""Smallest contrast (grey levels) of a ball. It must also exceed four times the image noise."""

MIN_CORRELATION = 0.75
"""Smallest correlation of a blurred ball with the template. The shaft and shading reduce it from 1
by up to 0.2."""

MAX_OUTLINE_SHIFT_PX = 5.0
"""Largest distance (px) of a blurred ball's outline from its template match."""

SAME_BALL_RADII = 0.7
"""Distance, as a fraction of the larger radius, below which two detections are the same ball."""

TEMPLATE_STD_PX = 2.0
"""Standard deviation (px) of a centre from the template match."""
OUTLINE_STD_RATIO = 0.08
"""Standard deviation of a centre from a blurred outline, as a fraction of the motion during the
exposure: shading and the shaft shift the ramp that blur makes of an edge."""


@dataclass(frozen=True, eq=False)
class Ball:
    """Silhouette of a whole ball, including any hidden part.

    Parameters
    ----------
    u : float
        Column of the centre (px).
    v : float
        Row of the centre (px).
    radius : float
        Radius (px).
    quality : float
        Quality of the observation, above 0 and at most 1.
    covariance : Floats
        Noise covariance of u, v and radius, (3, 3) px². NaN after a coarse fit.
    support : float
        Observed fraction of the outline, 0 to 1.
    """

    u: float

    v: float

    radius: float

    quality: float

    covariance: Floats = field(default_factory=lambda: np.full((3, 3), np.nan))

    support: float = 0.0

    @property
    def has_enough_outline(self) -> bool:
        """True if the observed part of the outline determines the centre."""
        return self.support >= MIN_SUPPORT

    def shift(self, du: float, dv: float) -> "Ball":
        """Return the ball displaced by (`du`, `dv`) px."""
        return replace(self, u=self.u + du, v=self.v + dv)

    def distance_to(self, other: "Ball") -> float:
        """Return the distance between the centres (px)."""
        return float(np.hypot(self.u - other.u, self.v - other.v))

    def is_same(self, other: "Ball") -> bool:
        """Report whether another detection is about the same ball."""
        return self.distance_to(other) < SAME_BALL_RADII * max(self.radius, other.radius)

    def is_within(self, width: int, height: int) -> bool:
        """Report whether the image contains the whole silhouette and a margin of one pixel."""
        margin = self.radius + 1.0
        return margin <= self.u <= width - 1 - margin and margin <= self.v <= height - 1 - margin


@compiled
def estimate_noise(response: Floats) -> float:
    """Return the standard deviation of the noise, from differences of neighbouring pixels."""
    stride = max(response.size // MIN_NOISE_SAMPLES, 1)
    line = response.ravel()
    return 1.05 * float(np.median(np.abs(line[1::stride] - line[:-1:stride])))


@compiled
def is_filled(response: Floats, ellipse: Floats, level: float) -> bool:
    """Report whether the response exceeds `level` near the centre.

    At least `MIN_FILLED_RAYS` rays must exceed it on `MIN_FILLED_FRACTION` of their length.
    """
    filled_rays = 0
    for k in range(RAY_COUNT):
        count = 0
        for n in range(SAMPLES_PER_RADIUS):
            distance = ellipse[2] * (n + 0.5) / SAMPLES_PER_RADIUS
            i = round(ellipse[1] + distance * RAY_SIN[k])
            j = round(ellipse[0] + distance * RAY_COS[k])
            if 0 <= i < response.shape[0] and 0 <= j < response.shape[1]:
                count += response[i, j] > level
        filled_rays += count >= MIN_FILLED_FRACTION * SAMPLES_PER_RADIUS
        if filled_rays == MIN_FILLED_RAYS:
            return True
    return False


def fit_ball(image: Image, colour: int, u: float, v: float, radius: float) -> Ball | None:
    """Return the ball in an image window, fitted to subpixel accuracy, or None.

    The centre (`u`, `v`) and the radius (px) are known to about a third of the radius. The fit
    first starts from the colour's centroid. Where the shaft hides one side, that centroid may lie
    too far from the centre; then the fit starts from the expected centre.
    """
    response = compute_colour_response(image, colour)
    noise = estimate_noise(response)
    for start in (find_colour_centroid(response, u, v, 1.2 * radius), (u, v)):
        outline = fit_outline(response, start, radius, 1.45 * radius)
        coarse_ball = _accept_ball(response, outline, outline[0], noise)
        if coarse_ball:
            break
    else:
        return None
    ellipse, rays, spread = outline
    trust = measure_ray_agreement(rays, ellipse)
    edge_ellipse, covariance = fit_edge(image, CHANNEL_MIXES[colour], ellipse, trust)
    is_precise = max(covariance[0, 0], covariance[1, 1]) <= MAX_CENTRE_STD_PX**2
    edge_support = measure_support(rays, ellipse, edge_ellipse)[0]
    if not (is_precise or edge_support >= MIN_SUPPORT_RATIO * coarse_ball.support):
        edge_ellipse, covariance = ellipse, spread**2 * np.eye(3)
    ball = _accept_ball(response, outline, edge_ellipse, noise)
    return replace(ball, covariance=covariance) if ball and ball.has_enough_outline else None


def fit_blurred_ball(
    image: Image, colour: int, last: Ball, motion: tuple[float, float]
) -> Ball | None:
    """Return a ball that moves by `motion` px during the exposure, or None.

    The ball comes from its outline. Where the outline is lost, it comes from the template match,
    which is less precise.
    """
    response = compute_colour_response(image, colour)
    match, noise = match_blurred_disc(response, last.radius, motion), estimate_noise(response)
    if match is None or match.correlation < MIN_CORRELATION:
        return None
    outline = fit_blurred_outline(response, (match.u, match.v), last.radius, motion)
    ball = _accept_ball(response, outline, outline[0], noise)
    shift = np.hypot(ball.u - match.u, ball.v - match.v) if ball else np.inf
    if ball and ball.has_enough_outline and shift < MAX_OUTLINE_SHIFT_PX:
        variance = outline[2] ** 2 + OUTLINE_STD_RATIO**2 * (motion[0] ** 2 + motion[1] ** 2)
        return replace(ball, covariance=variance * np.eye(3))
    if match.measure_contrast(response) < max(MIN_CONTRAST, 4.0 * noise):
        return None
    quality, covariance = 0.5 * match.correlation, TEMPLATE_STD_PX**2 * np.eye(3)
    return Ball(match.u, match.v, last.radius, quality, covariance)


@cache
def compile_blur_kernels() -> None:
    """Compile the kernels that a blurred ball needs, so that no compilation delays a run."""
    radius, motion = 2.0 * MIN_RADIUS_PX, (MIN_RADIUS_PX, 0.0)
    disc = np.pad(render_blurred_disc(radius, motion), int(radius))
    image = np.zeros((*disc.shape, 3), dtype=np.uint8)
    image[..., 2] = np.rint(200.0 * disc)
    centre = float(len(disc) // 2)
    assert fit_blurred_ball(image, 0, Ball(centre, centre, radius, 1.0), motion)


def fit_coarse_ball(
    response: Floats, u: float, v: float, radius: float, noise: float
) -> Ball | None:
    """Return the ball about a point inside it, without covariance, or None.

    The radius is known to a factor of about 1.5. `noise` is the noise of the response.
    """
    u, v, radius = fit_outline(response, (u, v), radius, 1.8 * radius)[0][:3].tolist()
    outline = fit_outline(response, (u, v), radius, 1.45 * radius)
    return _accept_ball(response, outline, outline[0], noise)


def _accept_ball(
    response: Floats, outline: tuple[Floats, Floats, float], ellipse: Floats, noise: float
) -> Ball | None:
    """Return an ellipse as a ball with its quality, or None if it fails a test.

    The `outline` is the result of `fit_outline` or `fit_blurred_outline`; its rays measure the
    support and the contrast of the ellipse.
    """
    outline_ellipse, rays, spread = outline
    support, contrast = measure_support(rays, outline_ellipse, ellipse)
    u, v, radius = (float(x) for x in ellipse[:3])
    max_spread, min_contrast = 0.5 + 0.04 * radius, max(MIN_CONTRAST, 4.0 * noise)
    is_round = radius >= MIN_RADIUS_PX and support >= MIN_COARSE_SUPPORT and spread <= max_spread
    if not (is_round and contrast >= min_contrast):
        return None
    if not is_filled(response, ellipse, 0.3 * contrast):
        return None
    clarity = contrast / (contrast + MIN_CONTRAST + 4.0 * noise)
    quality = support * clarity / (1.0 + (spread / max_spread) ** 2)
    return Ball(u, v, radius, quality, support=support)
