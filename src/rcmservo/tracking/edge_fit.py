"""Fit of the edge of a ball to the pixels about its outline, to a fraction of a pixel.

A pixel integrates the light that falls on it. A pixel on the outline therefore has the level

    background + covered fraction x (level of the ball - background)

The fit adjusts the ellipse and the light on the ball (shading.py) to the pixels by least squares.
All weights are continuous: an abrupt weight would let the result depend on the ball's position on
the pixel grid. A sector whose light does not balance is one where the shaft hides the outline; its
weight falls with the missing light.

The unknowns are those of shading.py, with the ellipse of circle_fit.py.
"""

import numpy as np

from rcmservo.interfaces import Floats, Image
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import fill, multiply_vector
from rcmservo.numerics.small_solvers import invert
from rcmservo.tracking.circle_fit import ELONGATION_STD, RAY_COS, RAY_COUNT, RAY_SIN
from rcmservo.tracking.shading import UNKNOWN_COUNT, evaluate_pixel

BAND_HALF_WIDTH_PX = 2.5
"""Largest distance (px) of a used pixel from the outline, inside and outside."""

BACKGROUND_OFFSETS_PX = (1.3, 1.9, 2.5, 3.1)
"""Distances (px) outside the outline at which the background is sampled."""

MAX_ITERATIONS = 10
"""Largest number of steps of the fit. The first step fits the levels only."""

STEP_TOLERANCE_PX = 0.05
"""Step size (px) below which the fit has converged."""

MAX_VARIANCE_RATIO = 2.0
"""Largest ratio of the residual variance to the noise variance. A larger one means that the pixels
show something else than a ball."""
MIN_NOISE_LEVEL = 2.0
"""Smallest assumed noise (grey levels): no real ball meets the model more closely."""

MAX_SECTOR_DEFICIT_PX, MAX_SECTOR_EXCESS_PX = 0.5, 1.0
"""Missing and excess light of a sector, as a shift of the outline (px), at which the weight of the
sector becomes 0."""

OUTLIER_GATE_STD = 8.0
"""Residual of a pixel, in standard deviations, at which its weight becomes 0."""

MIN_EDGE_PIXELS = 8.0
"""Smallest weighted number of pixels on the outline. Fewer determine no ellipse."""

MAX_FIT_SHIFT_PX = 1.0
"""Largest shift (px) of the ellipse by the fit, plus a tenth of the radius. A larger shift leads to
another outline."""


@compiled
def fit_edge(image: Image, mix: Floats, ellipse: Floats, trust: Floats) -> tuple[Floats, Floats]:
    """Fit the ellipse and the light of a ball to the pixels about its outline.

    Parameters
    ----------
    image : array (height, width, 3)
        Image, blue-green-red.
    mix : array (3,)
        Weight of each channel.
    ellipse : array (5,)
        Start (u, v, r, e1, e2), known to about a pixel.
    trust : array (RAY_COUNT,)
        Reliability of each part of the start, 0 to 1.

    Returns
    -------
    ellipse : array (5,)
        Fitted ellipse (px); NaN if the pixels do not determine one.
    covariance : array (3, 3)
        Noise covariance of u, v and r (px²); NaN likewise.
    """
    pixels = collect_edge_pixels(image, mix, ellipse, trust)
    x = np.zeros(UNKNOWN_COUNT)
    x[:5] = ellipse
    N, b, solved = np.zeros((UNKNOWN_COUNT, UNKNOWN_COUNT)), np.zeros(UNKNOWN_COUNT), False
    terms, sectors, gate = np.zeros((len(pixels), 8)), np.ones(RAY_COUNT), np.inf
    residuals, weights, variance = terms[:, 0], np.zeros(len(pixels)), np.inf
    for k in range(MAX_ITERATIONS):
        balance = evaluate_pixels(pixels, x, terms)
        if k > 1:
            sectors = weigh_sectors(balance)
        weights = weigh_pixels(pixels, residuals, sectors, gate)
        variance = (weights * residuals**2).sum() / max(weights.sum() - UNKNOWN_COUNT, 1.0)
        if k > 0:
            gate = min(gate, OUTLIER_GATE_STD * np.sqrt(variance))
        edge_weight = fill_normal_equations(terms, weights, N, b)
        add_prior(N, b, x, variance, k == 0)
        solved = edge_weight >= MIN_EDGE_PIXELS and invert(N)
        if not solved:
            break
        step = multiply_vector(N, b)
        x += step
        if k > 2 and np.abs(step[:3]).max() < STEP_TOLERANCE_PX:
            break
    shift = np.hypot(x[0] - ellipse[0], x[1] - ellipse[1]) + abs(x[2] - ellipse[2])
    noise = estimate_pixel_noise(pixels, residuals, weights)
    is_explained = variance <= MAX_VARIANCE_RATIO * max(noise, MIN_NOISE_LEVEL**2)
    if not (solved and is_explained and shift < MAX_FIT_SHIFT_PX + 0.1 * ellipse[2]):
        return np.full(5, np.nan), np.full((3, 3), np.nan)
    return x[:5], noise * N[:3, :3]


# ---------------------------------------------------------------- pixels about the outline


@compiled
def collect_edge_pixels(image: Image, mix: Floats, ellipse: Floats, trust: Floats) -> Floats:
    """Return the pixels near the ellipse (n, 6): column, row, value, trust, ray, background.

    The ray is a fractional ray number. The trust falls to 0 at the ends of the band.
    """
    u, v, r, e1, e2 = ellipse
    background = sample_background(image, mix, ellipse)
    reach = 1.1 * r + BAND_HALF_WIDTH_PX + 1.0
    top, bottom = max(int(v - reach), 0), min(int(v + reach) + 2, image.shape[0])
    left, right = max(int(u - reach), 0), min(int(u + reach) + 2, image.shape[1])
    pixels, n = np.empty((max(bottom - top, 0) * max(right - left, 0), 6)), 0
    for i in range(top, bottom):
        for j in range(left, right):
            dx, dy = j - u, i - v
            rho = np.sqrt(dx * dx + dy * dy)
            if not max(0.8 * r - BAND_HALF_WIDTH_PX, 1.0) < rho < reach:
                continue
            c, s = dx / rho, dy / rho
            margin = BAND_HALF_WIDTH_PX - abs(rho - r - e1 * (c * c - s * s) - e2 * 2.0 * c * s)
            if margin <= 0.0:
                continue
            ray = (np.arctan2(dy, dx) / (2.0 * np.pi) * RAY_COUNT) % RAY_COUNT
            trusted, level = interpolate_rays(trust, ray), interpolate_rays(background, ray)
            value = mix_pixel(image, mix, i, j)
            if trusted > 0.0 and np.isfinite(level + value):
                pixels[n, 0], pixels[n, 1], pixels[n, 2] = j, i, value
                pixels[n, 3], pixels[n, 4], pixels[n, 5] = min(margin, 1.0) * trusted, ray, level
                n += 1
    return pixels[:n]


@compiled
def sample_background(image: Image, mix: Floats, ellipse: Floats) -> Floats:
    """Return the level outside the ellipse along each ray (RAY_COUNT,); NaN outside the image."""
    u, v, r, e1, e2 = ellipse
    levels = np.zeros(RAY_COUNT)
    for k in range(RAY_COUNT):
        c, s = RAY_COS[k], RAY_SIN[k]
        radius = r + e1 * (c * c - s * s) + e2 * 2.0 * c * s
        for offset in BACKGROUND_OFFSETS_PX:
            levels[k] += interpolate_mix(
                image, mix, u + (radius + offset) * c, v + (radius + offset) * s
            )
    return levels / len(BACKGROUND_OFFSETS_PX)


@compiled
def mix_pixel(image: Image, mix: Floats, i: int, j: int) -> float:
    """Return the mixed channels of a pixel."""
    return mix[0] * image[i, j, 0] + mix[1] * image[i, j, 1] + mix[2] * image[i, j, 2]


@compiled
def interpolate_mix(image: Image, mix: Floats, u: float, v: float) -> float:
    """Return the mixed channels at a point between pixels; NaN outside the image."""
    if not (0.0 <= u < image.shape[1] - 1 and 0.0 <= v < image.shape[0] - 1):
        return np.nan
    i, j = int(v), int(u)
    a, b = v - i, u - j
    upper = (1.0 - b) * mix_pixel(image, mix, i, j) + b * mix_pixel(image, mix, i, j + 1)
    lower = (1.0 - b) * mix_pixel(image, mix, i + 1, j) + b * mix_pixel(image, mix, i + 1, j + 1)
    return (1.0 - a) * upper + a * lower


@compiled
def interpolate_rays(values: Floats, ray: float) -> float:
    """Return values of the rays (RAY_COUNT,) interpolated at a fractional ray number."""
    k = int(ray)
    return (1.0 - ray + k) * values[k % RAY_COUNT] + (ray - k) * values[(k + 1) % RAY_COUNT]


# ---------------------------------------------------------------- residuals and weights


@compiled
def evaluate_pixels(pixels: Floats, x: Floats, terms: Floats) -> Floats:
    """Fill `terms` (n, 8); return the excess light of each sector as an outline shift (px)."""
    excess, edge = np.zeros(RAY_COUNT), np.zeros(RAY_COUNT)
    for p in range(len(pixels)):
        evaluate_pixel(pixels[p], x, terms[p])
        k = int(pixels[p, 4])
        fraction = pixels[p, 4] - k
        for ray, part in ((k % RAY_COUNT, 1.0 - fraction), ((k + 1) % RAY_COUNT, fraction)):
            excess[ray] += part * terms[p, 0]
            edge[ray] += part * terms[p, 1]
    return np.where(edge > 1e-6, excess / edge, 0.0)


@compiled
def weigh_sectors(excess: Floats) -> Floats:
    """Return the weight of each sector (RAY_COUNT,), 0 to 1, from its excess light."""
    weights = np.zeros(RAY_COUNT)
    for k in range(RAY_COUNT):
        mean = 0.25 * (excess[k - 1] + 2.0 * excess[k] + excess[(k + 1) % RAY_COUNT])
        fraction = mean / (MAX_SECTOR_EXCESS_PX if mean > 0.0 else MAX_SECTOR_DEFICIT_PX)
        weights[k] = max(1.0 - fraction * fraction, 0.0) ** 2
    return weights


@compiled
def weigh_pixels(pixels: Floats, residuals: Floats, sectors: Floats, gate: float) -> Floats:
    """Return the weight of each pixel (n,): trust times sector weight times Tukey's weight."""
    weights = np.zeros(len(pixels))
    for p in range(len(pixels)):
        inside = max(1.0 - (residuals[p] / gate) ** 2, 0.0)
        weights[p] = pixels[p, 3] * interpolate_rays(sectors, pixels[p, 4]) * inside**2
    return weights


# ---------------------------------------------------------------- least squares


@compiled
def fill_normal_equations(terms: Floats, weights: Floats, N: Floats, b: Floats) -> float:
    """Fill N (9, 9) and b (9,) of the next step; return the weighted number of edge pixels."""
    fill(N, 0.0)
    fill(b, 0.0)
    edge_weight, row = 0.0, np.zeros(UNKNOWN_COUNT)
    for p in range(len(terms)):
        residual, slope, c, s, fraction, x, y, z = terms[p]
        if weights[p] == 0.0 or fraction == 0.0:
            continue
        row[5], row[6], row[7] = fraction, fraction * x, fraction * y
        row[8] = z
        first = 5
        if slope != 0.0:
            first, edge_weight = 0, edge_weight + weights[p]
            row[0], row[1], row[2] = slope * c, slope * s, slope
            row[3], row[4] = slope * (c * c - s * s), slope * 2.0 * c * s
        for k in range(first, UNKNOWN_COUNT):
            part = weights[p] * row[k]
            for m in range(k, UNKNOWN_COUNT):
                N[k, m] += part * row[m]
            b[k] += part * residual
    for k in range(UNKNOWN_COUNT):
        for m in range(k):
            N[k, m] = N[m, k]
    return edge_weight


@compiled
def add_prior(N: Floats, b: Floats, x: Floats, variance: float, hold_ellipse: bool) -> None:
    """Add the prior of the elongation and a small damping of the levels to the normal equations.

    `hold_ellipse` removes the ellipse from the unknowns.
    """
    tightness = max(variance, 1.0) / (ELONGATION_STD * x[2]) ** 2
    for k in (3, 4):
        N[k, k] += tightness
        b[k] -= tightness * x[k]
    for k in range(5):
        if hold_ellipse:
            N[k, :], N[:, k], b[k] = 0.0, 0.0, 0.0
            N[k, k] = 1.0
    for k in range(5, UNKNOWN_COUNT):
        N[k, k] += 1e-3


@compiled
def estimate_pixel_noise(pixels: Floats, residuals: Floats, weights: Floats) -> float:
    """Return the noise variance of the pixels from residual differences of neighbours.

    Model errors cancel in the difference, because neighbours have the same.
    """
    total, count = 1e-6, 1e-6
    for p in range(1, len(pixels)):
        if pixels[p, 0] == pixels[p - 1, 0] + 1.0 and pixels[p, 1] == pixels[p - 1, 1]:
            pair_weight = weights[p] * weights[p - 1]
            total += 0.5 * pair_weight * (residuals[p] - residuals[p - 1]) ** 2
            count += pair_weight
    return total / count
