"""The rim of a ball: the pixels about its outline, and the ellipse that explains them best.

Each pixel integrates the light that falls on it. So a pixel on the outline shows

    level beyond + covered share x (the ball's level - level beyond)

and the ellipse is fitted to the pixels themselves, by least squares, together with the light that
falls on the ball (shading.py). All weights are continuous: where a pixel counts or not by a hair,
the ball's place on the grid of pixels shows in the result. Sectors whose light does not balance are
those where the shaft hides the outline; they count the less the more is missing.

The unknowns are those of shading.py, the ellipse being that of outline.py.
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats, Image
from rcmservo.loops import fill, product
from rcmservo.numerics.small_solvers import invert
from rcmservo.tracking.outline import COS, ELONGATION, RAYS, SIN
from rcmservo.tracking.shading import UNKNOWNS, explain

BAND = 2.5
"""px. How far within and beyond the outline pixels are looked at."""

BEYOND = (1.3, 1.9, 2.5, 3.1)
"""px. Where beyond the outline the surroundings are measured."""

ROUNDS = 10
"""Steps of the fit at most. The first one fits the levels only."""

STILL = 0.05
"""px. A step so small is the last one."""

UNEXPLAINED = 2.0
"""Times the noise's variance. Of pixels that miss by more, something else than this is shown,"""
QUIET = 2.0
"""grey levels; a picture with less noise counts as one with so much: no ball is quite as the fit
has it."""

SHORT, SPARE = 0.5, 1.0
"""px. A sector counts nothing whose light falls short of the ellipse, or exceeds it, by so much."""

GATE = 8.0
"""Standard deviations by which a pixel misses that counts nothing."""

LEAST_RIM = 8.0
"""Pixels on the outline. Fewer tell nothing."""

FARTHEST = 1.0
"""px, and a tenth of the radius more. What is found further from the start is another outline."""


@compiled
def fit_rim(image: Image, mix: Floats, ellipse: Floats, trust: Floats) -> tuple[Floats, Floats]:
    """The ellipse (u, v, r, e1, e2) and the covariance (3, 3) of u, v and r.

    It starts from an `ellipse` that is known to about a pixel, with a `trust` (RAYS,) from 0 to 1
    in its parts. `mix` (3,) weighs the channels. NaN where the pixels do not tell.
    """
    pixels = rim_pixels(image, mix, ellipse, trust)
    x = np.zeros(UNKNOWNS)
    x[:5] = ellipse
    N, b, solved = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), False
    spots, sectors, gate = np.zeros((len(pixels), 8)), np.ones(RAYS), np.inf
    left, weights, variance = spots[:, 0], np.zeros(len(pixels)), np.inf
    for k in range(ROUNDS):
        balance = look(pixels, x, spots)
        if k > 1:
            sectors = balanced(balance)
        weights = weighed(pixels, left, sectors, gate)
        variance = (weights * left**2).sum() / max(weights.sum() - UNKNOWNS, 1.0)
        if k > 0:
            gate = min(gate, GATE * np.sqrt(variance))
        on_rim = normal_equations(spots, weights, N, b)
        restrain(N, b, x, variance, k == 0)
        solved = on_rim >= LEAST_RIM and invert(N)
        if not solved:
            break
        step = product(N, b)
        x += step
        if k > 2 and np.abs(step[:3]).max() < STILL:
            break
    away = np.hypot(x[0] - ellipse[0], x[1] - ellipse[1]) + abs(x[2] - ellipse[2])
    noise = grain(pixels, left, weights)
    explained = variance <= UNEXPLAINED * max(noise, QUIET**2)
    if not (solved and explained and away < FARTHEST + 0.1 * ellipse[2]):
        return np.full(5, np.nan), np.full((3, 3), np.nan)
    return x[:5], noise * N[:3, :3]


# ---------------------------------------------------------------- the pixels


@compiled
def rim_pixels(image: Image, mix: Floats, ellipse: Floats, trust: Floats) -> Floats:
    """The pixels near the ellipse (n, 6): column, row, amount, trust, ray, level beyond.

    The ray is that before the pixel, with the share of the way to the next one. Trust falls to
    nothing at the ends of the band.
    """
    u, v, r, e1, e2 = ellipse
    beyond = surroundings(image, mix, ellipse)
    reach = 1.1 * r + BAND + 1.0
    top, bottom = max(int(v - reach), 0), min(int(v + reach) + 2, image.shape[0])
    left, right = max(int(u - reach), 0), min(int(u + reach) + 2, image.shape[1])
    pixels, n = np.empty((max(bottom - top, 0) * max(right - left, 0), 6)), 0
    for i in range(top, bottom):
        for j in range(left, right):
            dx, dy = j - u, i - v
            rho = np.sqrt(dx * dx + dy * dy)
            if not max(0.8 * r - BAND, 1.0) < rho < reach:
                continue
            c, s = dx / rho, dy / rho
            room = BAND - abs(rho - r - e1 * (c * c - s * s) - e2 * 2.0 * c * s)
            if room <= 0.0:
                continue
            ray = (np.arctan2(dy, dx) / (2.0 * np.pi) * RAYS) % RAYS
            counts, level = between(trust, ray), between(beyond, ray)
            shown = amount(image, mix, i, j)
            if counts > 0.0 and np.isfinite(level + shown):
                pixels[n, 0], pixels[n, 1], pixels[n, 2] = j, i, shown
                pixels[n, 3], pixels[n, 4], pixels[n, 5] = min(room, 1.0) * counts, ray, level
                n += 1
    return pixels[:n]


@compiled
def surroundings(image: Image, mix: Floats, ellipse: Floats) -> Floats:
    """The level just beyond the ellipse along each ray (RAYS,); NaN outside of the picture."""
    u, v, r, e1, e2 = ellipse
    levels = np.zeros(RAYS)
    for k in range(RAYS):
        c, s = COS[k], SIN[k]
        radius = r + e1 * (c * c - s * s) + e2 * 2.0 * c * s
        for out in BEYOND:
            levels[k] += amount_at(image, mix, u + (radius + out) * c, v + (radius + out) * s)
    return levels / len(BEYOND)


@compiled
def amount(image: Image, mix: Floats, i: int, j: int) -> float:
    """How much of the mixed colour is in a pixel."""
    return mix[0] * image[i, j, 0] + mix[1] * image[i, j, 1] + mix[2] * image[i, j, 2]


@compiled
def amount_at(image: Image, mix: Floats, u: float, v: float) -> float:
    """The same between pixels; NaN outside of the picture."""
    if not (0.0 <= u < image.shape[1] - 1 and 0.0 <= v < image.shape[0] - 1):
        return np.nan
    i, j = int(v), int(u)
    a, b = v - i, u - j
    upper = (1.0 - b) * amount(image, mix, i, j) + b * amount(image, mix, i, j + 1)
    lower = (1.0 - b) * amount(image, mix, i + 1, j) + b * amount(image, mix, i + 1, j + 1)
    return (1.0 - a) * upper + a * lower


@compiled
def between(values: Floats, ray: float) -> float:
    """A value (RAYS,) of rays, at a place between two of them."""
    k = int(ray)
    return (1.0 - ray + k) * values[k % RAYS] + (ray - k) * values[(k + 1) % RAYS]


# ---------------------------------------------------------------- what the ellipse makes of them


@compiled
def look(pixels: Floats, x: Floats, spots: Floats) -> Floats:
    """Fill `spots` (n, 8); by how many px each sector's light is more than x says (RAYS,)."""
    excess, edge = np.zeros(RAYS), np.zeros(RAYS)
    for p in range(len(pixels)):
        explain(pixels[p], x, spots[p])
        k = int(pixels[p, 4])
        share = pixels[p, 4] - k
        for ray, part in ((k % RAYS, 1.0 - share), ((k + 1) % RAYS, share)):
            excess[ray] += part * spots[p, 0]
            edge[ray] += part * spots[p, 1]
    return np.where(edge > 1e-6, excess / edge, 0.0)


@compiled
def balanced(excess: Floats) -> Floats:
    """How much each sector counts (RAYS,), from 0 to 1."""
    counts = np.zeros(RAYS)
    for k in range(RAYS):
        mean = 0.25 * (excess[k - 1] + 2.0 * excess[k] + excess[(k + 1) % RAYS])
        share = mean / (SPARE if mean > 0.0 else SHORT)
        counts[k] = max(1.0 - share * share, 0.0) ** 2
    return counts


@compiled
def weighed(pixels: Floats, left: Floats, sectors: Floats, gate: float) -> Floats:
    """How much each pixel counts (n,): Tukey's weight of what is left of it, in its sector."""
    weights = np.zeros(len(pixels))
    for p in range(len(pixels)):
        inside = max(1.0 - (left[p] / gate) ** 2, 0.0)
        weights[p] = pixels[p, 3] * between(sectors, pixels[p, 4]) * inside**2
    return weights


# ---------------------------------------------------------------- least squares


@compiled
def normal_equations(spots: Floats, weights: Floats, N: Floats, b: Floats) -> float:
    """Write N (9, 9) and b (9,) of the next step; how many pixels on the outline count."""
    fill(N, 0.0)
    fill(b, 0.0)
    on_rim, row = 0.0, np.zeros(UNKNOWNS)
    for p in range(len(spots)):
        left, slope, c, s, share, x, y, z = spots[p]
        if weights[p] == 0.0 or share == 0.0:
            continue
        row[5], row[6], row[7] = share, share * x, share * y
        row[8] = z
        first = 5
        if slope != 0.0:
            first, on_rim = 0, on_rim + weights[p]
            row[0], row[1], row[2] = slope * c, slope * s, slope
            row[3], row[4] = slope * (c * c - s * s), slope * 2.0 * c * s
        for k in range(first, UNKNOWNS):
            part = weights[p] * row[k]
            for l in range(k, UNKNOWNS):
                N[k, l] += part * row[l]
            b[k] += part * left
    for k in range(UNKNOWNS):
        for l in range(k):
            N[k, l] = N[l, k]
    return on_rim


@compiled
def restrain(N: Floats, b: Floats, x: Floats, variance: float, still: bool) -> None:
    """Add the prior of the elongation, and a trace of one of the levels; `still` holds the
    ellipse."""
    tightness = max(variance, 1.0) / (ELONGATION * x[2]) ** 2
    for k in (3, 4):
        N[k, k] += tightness
        b[k] -= tightness * x[k]
    for k in range(5):
        if still:
            N[k, :], N[:, k], b[k] = 0.0, 0.0, 0.0
            N[k, k] = 1.0
    for k in range(5, UNKNOWNS):
        N[k, k] += 1e-3


@compiled
def grain(pixels: Floats, left: Floats, weights: Floats) -> float:
    """The variance of the pixels' noise, from what is left of neighbours: what the unknowns explain
    badly is alike in both."""
    total, count = 1e-6, 1e-6
    for p in range(1, len(pixels)):
        if pixels[p, 0] == pixels[p - 1, 0] + 1.0 and pixels[p, 1] == pixels[p - 1, 1]:
            both = weights[p] * weights[p - 1]
            total += 0.5 * both * (left[p] - left[p - 1]) ** 2
            count += both
    return total / count
