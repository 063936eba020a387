"""Fit of the outline of a ball in an image, including hidden parts, to about half a pixel.

Rays leave a point inside the ball. The outermost strong drop of the colour response on a ray is an
outline point. The shaft, a highlight or a worn patch moves some of these points inwards, never
outwards. The circle through three points that most other points support separates the valid points
from the others. A robust least squares fit about the centre (u, v) follows:

    radius(phi) = r + e1 cos(2 phi) + e2 sin(2 phi)

edge_fit.py refines it on the pixels. The image of a ball off the optical axis is an ellipse with
the elongation (e1, e2). A prior keeps the elongation small, because a short arc cannot distinguish
it from a shift. All lengths are in px.
"""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import fill, multiply_vector
from rcmservo.numerics.small_solvers import invert

RAY_COUNT = 64
"""Number of rays from the inside to the outline."""

ELONGATION_STD = 0.03
"""Prior standard deviation of e1/r and e2/r. A ball 25 degrees off the axis has 0.025."""

MIN_SPREAD_PX = 0.08
"""Smallest assumed standard deviation (px) of outline points."""

CORRELATED_ERROR_PX = 0.6
"""Error (px) that neighbouring rays may have in common, hidden from their spread: the tips of a
crescent lie too far out. The prior of the elongation assumes at least this error."""

RAY_ANGLES = 2.0 * np.pi * np.arange(RAY_COUNT) / RAY_COUNT
"""Directions of the rays (rad)."""
RAY_COS, RAY_SIN = np.cos(RAY_ANGLES), np.sin(RAY_ANGLES)
"""Cosine and sine of each direction."""

RADIUS_JACOBIAN = np.column_stack(
    [np.ones(RAY_COUNT), RAY_COS, RAY_SIN, np.cos(2.0 * RAY_ANGLES), np.sin(2.0 * RAY_ANGLES)]
)
"""Derivative of radius(phi) by (r, du, dv, e1, e2) for each ray, (RAY_COUNT, 5)."""


@compiled
def fit_outline(
    response: Floats, start: tuple[float, float], radius: float, reach: float
) -> tuple[Floats, Floats, float]:
    """Fit the outline of a ball of roughly `radius` about a `start` inside it.

    Parameters
    ----------
    response : array (height, width)
        Colour response.
    start : tuple (u, v)
        Point inside the ball (px).
    radius : float
        Expected radius (px).
    reach : float
        Length of the first rays (px): the radius plus the uncertainty of start and radius.

    Returns
    -------
    ellipse : array (5,)
        (u, v, r, e1, e2) in px; NaN if no ball is found.
    rays : array (2, RAY_COUNT)
        Distance (px) of each outline point from the ellipse's centre; drop of the response there.
    spread : float
        Standard deviation (px) of the accepted points about the ellipse.
    """
    if not radius >= 2.0:
        return np.full(5, np.nan), np.full((2, RAY_COUNT), np.nan), np.nan
    distances, _ = cast_rays(response, start, (radius, reach))
    du, dv, radius = find_consensus_circle(distances, reach)
    u, v = start[0] + du, start[1] + dv
    if not (radius >= 2.0 and 0.0 <= u < response.shape[1] and 0.0 <= v < response.shape[0]):
        return np.full(5, np.nan), np.full((2, RAY_COUNT), np.nan), np.nan
    distances, drop = cast_rays(response, (u, v), (radius, 1.35 * radius + 2.0))
    fit, spread = fit_robust_ellipse(distances, radius)
    ellipse = np.array([u + fit[1], v + fit[2], fit[0], fit[3], fit[4]])
    rays = np.empty((2, RAY_COUNT))
    rays[0], rays[1] = distances - fit[1] * RAY_COS - fit[2] * RAY_SIN, drop
    return ellipse, rays, spread


@compiled
def find_colour_centroid(
    response: Floats, u: float, v: float, radius: float
) -> tuple[float, float]:
    """Return the colour's centroid within a disc that moves along with it: a start for the rays."""
    height, width = response.shape
    for _ in range(3):
        mass, mass_u, mass_v = 0.0, 0.0, 0.0
        for i in range(max(int(v - radius), 0), min(int(v + radius) + 2, height)):
            for j in range(max(int(u - radius), 0), min(int(u + radius) + 2, width)):
                if (i - v) ** 2 + (j - u) ** 2 <= radius**2 and response[i, j] > 0.0:
                    mass += response[i, j] ** 2
                    mass_u += response[i, j] ** 2 * j
                    mass_v += response[i, j] ** 2 * i
        if mass == 0.0:
            break
        u, v = mass_u / mass, mass_v / mass
    return u, v


# ---------------------------------------------------------------- outline points


@compiled
def cast_rays(
    response: Floats, start: tuple[float, float], lengths: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Return the distance from `start` to the outline along each ray, and the response drop there.

    The distance is NaN where no outline is found. `lengths` holds the expected radius and the
    length of the rays.
    """
    (radius, reach), step = lengths, 0.5
    half = round(min(max(0.3 * radius, 2.0), 3.0) / step)
    profile = np.empty(int(reach / step) + half + 1)
    drops = np.zeros(profile.size)
    distances, drop = np.full(RAY_COUNT, np.nan), np.zeros(RAY_COUNT)
    for i in range(RAY_COUNT):
        n = sample_ray(response, start, (step * RAY_COS[i], step * RAY_SIN[i]), profile)
        edge = find_outermost_drop(profile[:n], half, drops)
        if edge >= 0:
            distances[i] = step * locate_half_level(profile, edge, half)
            drop[i] = drops[edge]
    return distances, drop


@compiled
def sample_ray(
    response: Floats, start: tuple[float, float], step: tuple[float, float], profile: Floats
) -> int:
    """Fill `profile` with the response along a ray; return the count of samples in the image."""
    height, width = response.shape
    for k in range(profile.size):
        u, v = start[0] + k * step[0], start[1] + k * step[1]
        if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
            return k
        i, j = int(v), int(u)
        a, b = v - i, u - j
        upper = (1.0 - b) * response[i, j] + b * response[i, j + 1]
        lower = (1.0 - b) * response[i + 1, j] + b * response[i + 1, j + 1]
        profile[k] = (1.0 - a) * upper + a * lower
    return profile.size


@compiled
def find_outermost_drop(profile: Floats, half: int, drops: Floats) -> int:
    """Return the outermost sample with at least 0.3 of the steepest drop of the profile, or -1.

    A drop is the difference of the means of `half` samples on both sides. It counts only where the
    inside shows the colour: a grey shaft before a background of the opposite colour drops as well.
    """
    last = profile.size - half - 1
    if last < half:
        return -1
    steepest, strongest = 0.0, profile.max()
    for k in range(half, last + 1):
        inside, outside = mean(profile, k - half, k), mean(profile, k + 1, k + 1 + half)
        drops[k] = inside - outside if inside > 0.16 * strongest else 0.0
        steepest = max(steepest, drops[k])
    if steepest <= 0.0:
        return -1
    k = last
    while drops[k] < 0.3 * steepest:
        k -= 1
    while k > half and drops[k - 1] > drops[k]:
        k -= 1
    return k


@compiled
def locate_half_level(profile: Floats, edge: int, half: int) -> float:
    """Return the position near `edge` where the profile is midway between inside and outside.

    Linear interpolation places it between samples.
    """
    inside = mean(profile, edge - half // 2, edge - half // 4)
    outside = mean(profile, edge + half // 2 + 1, edge + half + 1)
    level = 0.5 * (inside + outside)
    nearest, smallest_distance = np.nan, np.inf
    for k in range(edge - half, edge + half):
        if profile[k] >= level > profile[k + 1]:
            position = k + (profile[k] - level) / (profile[k] - profile[k + 1])
            if abs(position - edge) < smallest_distance:
                nearest, smallest_distance = position, abs(position - edge)
    return nearest


@compiled
def mean(values: Floats, start: int, stop: int) -> float:
    total = 0.0
    for k in range(start, stop):
        total += values[k]
    return total / (stop - start)


# ---------------------------------------------------------------- robust fit of the points


@compiled
def find_consensus_circle(distances: Floats, largest: float) -> tuple[float, float, float]:
    """Return the circle (du, dv, radius) through three points that most other points support.

    Its centre is relative to the start of the rays.
    """
    x, y = distances * RAY_COS, distances * RAY_SIN
    best_score, best_circle = 0.0, (np.nan, np.nan, np.nan)
    for gap in (7, 11, 16, 21):
        for i in range(0, RAY_COUNT, 2):
            circle = construct_circle(x, y, (i, (i + gap) % RAY_COUNT, (i + 2 * gap) % RAY_COUNT))
            if circle[2] <= largest:
                score = score_circle(x, y, circle)
                if score > best_score:
                    best_score, best_circle = score, circle
    return best_circle


@compiled
def construct_circle(
    x: Floats, y: Floats, indices: tuple[int, int, int]
) -> tuple[float, float, float]:
    """Return the circle (u, v, radius) through three of the points.

    It is NaN or infinite if they lie on a line.
    """
    i, j, k = indices
    xj, yj, xk, yk = x[j] - x[i], y[j] - y[i], x[k] - x[i], y[k] - y[i]
    det = 2.0 * (xj * yk - yj * xk)
    sj, sk = xj * xj + yj * yj, xk * xk + yk * yk
    a, b = (yk * sj - yj * sk) / det, (xj * sk - xk * sj) / det
    return x[i] + a, y[i] + b, np.sqrt(a * a + b * b)


@compiled
def score_circle(x: Floats, y: Floats, circle: tuple[float, float, float]) -> float:
    """Return the support of a circle: every second point counts up to 1 near it, and -1 outside."""
    a, b, radius = circle
    tolerance = max(0.04 * radius, 0.7)
    score = 0.0
    for i in range(0, x.size, 2):
        residual = (np.sqrt((x[i] - a) ** 2 + (y[i] - b) ** 2) - radius) / tolerance
        if abs(residual) < 1.0:
            score += 1.0 - residual * residual
        elif residual > 1.0:
            score -= 1.0  # hidden parts and highlights never move a point outwards
    return score


@compiled
def fit_robust_ellipse(distances: Floats, radius: float) -> tuple[Floats, float]:
    """Fit the ellipse (r, du, dv, e1, e2) to the points; return it and the spread of the points.

    Iteratively reweighted least squares with Tukey's weights, whose width follows the spread.
    """
    fit = np.array([radius, 0.0, 0.0, 0.0, 0.0])
    gate, spread = max(0.08 * radius, 1.5), MIN_SPREAD_PX
    for _ in range(8):
        residual = compute_radial_residuals(distances, fit)
        near = np.sort(np.abs(residual))
        count = np.searchsorted(near, gate)
        if count < 8:
            break
        spread = max(1.4826 * near[count // 2], MIN_SPREAD_PX)
        gate = min(gate, 4.0 * spread)
        prior = (max(spread, CORRELATED_ERROR_PX) / (ELONGATION_STD * radius)) ** 2
        fit = fit + solve_weighted_step(residual, fit, gate, prior)
    return fit, spread


@compiled
def compute_radial_residuals(distances: Floats, fit: Floats) -> Floats:
    """Return the distance of each point outside the ellipse (px); NaN where there is no point."""
    residual = np.empty(RAY_COUNT)
    for i in range(RAY_COUNT):
        residual[i] = distances[i]
        for k in range(5):
            residual[i] -= RADIUS_JACOBIAN[i, k] * fit[k]
    return residual


@compiled
def measure_ray_agreement(rays: Floats, ellipse: Floats) -> Floats:
    """Return the agreement of each outline point with the ellipse, 0 to 1, (RAY_COUNT,)."""
    gate = max(1.5, 0.06 * ellipse[2])
    residual = compute_radial_residuals(
        rays[0], np.array([ellipse[2], 0.0, 0.0, ellipse[3], ellipse[4]])
    )
    agrees = np.zeros(RAY_COUNT)
    for i in range(RAY_COUNT):
        if abs(residual[i]) < gate:
            agrees[i] = min(2.0 - 2.0 * abs(residual[i]) / gate, 1.0)
    return agrees


@compiled
def solve_weighted_step(residual: Floats, fit: Floats, gate: float, prior: float) -> Floats:
    """Return one least squares step of the fit.

    The weight of a point falls with its residual and is 0 beyond `gate`.
    """
    N, b = np.zeros((5, 5)), np.zeros(5)
    for k in (3, 4):
        N[k, k], b[k] = prior, -prior * fit[k]
    for i in range(RAY_COUNT):
        if abs(residual[i]) < gate:
            weight = (1.0 - (residual[i] / gate) ** 2) ** 2
            for k in range(5):
                for m in range(5):
                    N[k, m] += weight * RADIUS_JACOBIAN[i, k] * RADIUS_JACOBIAN[i, m]
                b[k] += weight * RADIUS_JACOBIAN[i, k] * residual[i]
    if not invert(N):
        fill(N, np.nan)
    return multiply_vector(N, b)


@compiled
def measure_support(rays: Floats, ellipse: Floats, other: Floats) -> tuple[float, float]:
    """Return the support and the contrast of the `other` ellipse by the rays of an `ellipse`.

    The support is the fraction of rays whose point lies on the other ellipse and whose drop is not
    much smaller than the median drop. The contrast is that median.
    """
    fit = np.array([other[2], other[0] - ellipse[0], other[1] - ellipse[1], other[3], other[4]])
    on = np.abs(compute_radial_residuals(rays[0], fit)) < 0.4 + 0.02 * fit[0]
    if not on.any():
        return 0.0, 0.0
    contrast = float(np.median(rays[1][on]))
    return (rays[1][on] > 0.3 * contrast).sum() / RAY_COUNT, contrast
