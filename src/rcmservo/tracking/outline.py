"""The outline of a ball in a picture: where it would be if nothing hid a part of it.

Rays leave a point inside the ball. On each ray, the outermost strong fall of the colour is an
outline point. The shaft, a highlight or a worn patch puts some of these points too far inside,
never outside. A circle through three points that most of the others agree with tells them apart.
Then a robust least squares fit of

    radius(phi) = r + e1 cos(2 phi) + e2 sin(2 phi)    about the centre (u, v)

gives the outline to about half a pixel; rim.py fits it to the pixels from there. The image of a
ball off the optical axis is an ellipse: e1 and e2 are its elongation. A prior keeps them small, or
a short arc could not tell an elongation from a shift. All lengths in px.
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import fill, product
from rcmservo.numerics.small_solvers import invert

RAYS = 64
"""From the inside to the outline."""

ELONGATION = 0.03
"""The prior's standard deviation of e1/r and e2/r. A ball 25 degrees off the axis has 0.025."""

SHARPEST = 0.08
"""px. No outline is trusted to be better than this."""

ALIKE = 0.6
"""px. What neighbouring rays may miss alike, so that their spread does not tell it: a crescent's
tips lie too far out. The elongation gives way to no less."""

TURN = 2.0 * np.pi * np.arange(RAYS) / RAYS
COS, SIN = np.cos(TURN), np.sin(TURN)
"""The directions of the rays, rad."""

ROWS = np.column_stack([np.ones(RAYS), COS, SIN, np.cos(2.0 * TURN), np.sin(2.0 * TURN)])
"""The derivative of radius(phi) by (r, dx, dy, e1, e2) in the direction of each ray."""


@compiled
def fit_outline(
    weights: Floats, start: tuple[float, float], radius: float, reach: float
) -> tuple[Floats, Floats, float]:
    """The ball about a `start` of roughly `radius`: its ellipse (u, v, r, e1, e2), the rays and the
    spread of their points about it.

    NaN where there is none. The first rays are `reach` long: longer than the radius by as much as
    start and radius are in doubt. The rays (2, RAYS) are each point's distance from the ellipse's
    centre and the colour's fall there; the spread is the standard deviation of those that agree.
    """
    if not radius >= 2.0:
        return np.full(5, np.nan), np.full((2, RAYS), np.nan), np.nan
    distance, _ = cast_rays(weights, start, (radius, reach))
    du, dv, radius = start_circle(distance, reach)
    u, v = start[0] + du, start[1] + dv
    if not (radius >= 2.0 and 0.0 <= u < weights.shape[1] and 0.0 <= v < weights.shape[0]):
        return np.full(5, np.nan), np.full((2, RAYS), np.nan), np.nan
    distance, fall = cast_rays(weights, (u, v), (radius, 1.35 * radius + 2.0))
    fit, spread = robust_ellipse(distance, radius)
    ellipse = np.array([u + fit[1], v + fit[2], fit[0], fit[3], fit[4]])
    rays = np.empty((2, RAYS))
    rays[0], rays[1] = distance - fit[1] * COS - fit[2] * SIN, fall
    return ellipse, rays, spread


@compiled
def disc_centre(weights: Floats, u: float, v: float, radius: float) -> tuple[float, float]:
    """Where the first rays may start: the colour's centre of mass within a disc that moves along
    with it."""
    height, width = weights.shape
    for _ in range(3):
        mass, mass_u, mass_v = 0.0, 0.0, 0.0
        for i in range(max(int(v - radius), 0), min(int(v + radius) + 2, height)):
            for j in range(max(int(u - radius), 0), min(int(u + radius) + 2, width)):
                if (i - v) ** 2 + (j - u) ** 2 <= radius**2 and weights[i, j] > 0.0:
                    mass += weights[i, j] ** 2
                    mass_u += weights[i, j] ** 2 * j
                    mass_v += weights[i, j] ** 2 * i
        if mass == 0.0:
            break
        u, v = mass_u / mass, mass_v / mass
    return u, v


# ---------------------------------------------------------------- the outline's points


@compiled
def cast_rays(
    weights: Floats, start: tuple[float, float], lengths: tuple[float, float]
) -> tuple[Floats, Floats]:
    """The distance from `start` to the outline along each ray, and the colour's fall there.

    NaN where no outline is found. The `lengths` are the radius that is expected, and the rays'.
    """
    (radius, reach), step = lengths, 0.5
    half = round(min(max(0.3 * radius, 2.0), 3.0) / step)
    profile = np.empty(int(reach / step) + half + 1)
    falls = np.zeros(profile.size)
    distance, fall = np.full(RAYS, np.nan), np.zeros(RAYS)
    for i in range(RAYS):
        n = ray_profile(weights, start, (step * COS[i], step * SIN[i]), profile)
        edge = outermost_fall(profile[:n], half, falls)
        if edge >= 0:
            distance[i] = step * half_level(profile, edge, half)
            fall[i] = falls[edge]
    return distance, fall


@compiled
def ray_profile(
    weights: Floats, start: tuple[float, float], step: tuple[float, float], profile: Floats
) -> int:
    """Fill `profile` with the weights along a ray.

    Gives how many samples lie within the picture.
    """
    height, width = weights.shape
    for k in range(profile.size):
        u, v = start[0] + k * step[0], start[1] + k * step[1]
        if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
            return k
        i, j = int(v), int(u)
        a, b = v - i, u - j
        upper = (1.0 - b) * weights[i, j] + b * weights[i, j + 1]
        lower = (1.0 - b) * weights[i + 1, j] + b * weights[i + 1, j + 1]
        profile[k] = (1.0 - a) * upper + a * lower
    return profile.size


@compiled
def outermost_fall(profile: Floats, half: int, falls: Floats) -> int:
    """The outermost sample where the mean of `half` samples falls a third as much as anywhere.

    -1 where there is none. Only a fall from the colour counts: a grey shaft before a background of
    the opposite colour falls as well.
    """
    last = profile.size - half - 1
    if last < half:
        return -1
    steepest, strongest = 0.0, profile.max()
    for k in range(half, last + 1):
        inside, outside = mean(profile, k - half, k), mean(profile, k + 1, k + 1 + half)
        falls[k] = inside - outside if inside > 0.16 * strongest else 0.0
        steepest = max(steepest, falls[k])
    if steepest <= 0.0:
        return -1
    k = last
    while falls[k] < 0.3 * steepest:
        k -= 1
    while k > half and falls[k - 1] > falls[k]:
        k -= 1
    return k


@compiled
def half_level(profile: Floats, edge: int, half: int) -> float:
    """The place near `edge`, between samples, where the profile is midway between its levels inside
    and outside."""
    inside = mean(profile, edge - half // 2, edge - half // 4)
    outside = mean(profile, edge + half // 2 + 1, edge + half + 1)
    level = 0.5 * (inside + outside)
    best, least = np.nan, np.inf
    for k in range(edge - half, edge + half):
        if profile[k] >= level > profile[k + 1]:
            place = k + (profile[k] - level) / (profile[k] - profile[k + 1])
            if abs(place - edge) < least:
                best, least = place, abs(place - edge)
    return best


@compiled
def mean(values: Floats, start: int, stop: int) -> float:
    total = 0.0
    for k in range(start, stop):
        total += values[k]
    return total / (stop - start)


# ---------------------------------------------------------------- what they agree on


@compiled
def start_circle(distance: Floats, largest: float) -> tuple[float, float, float]:
    """The circle through three points that most of the others agree with.

    Its centre from the rays' start, and its radius.
    """
    x, y = distance * COS, distance * SIN
    best, chosen = 0.0, (np.nan, np.nan, np.nan)
    for gap in (7, 11, 16, 21):
        for i in range(0, RAYS, 2):
            circle = through(x, y, (i, (i + gap) % RAYS, (i + 2 * gap) % RAYS))
            if circle[2] <= largest:
                score = agreement(x, y, circle)
                if score > best:
                    best, chosen = score, circle
    return chosen


@compiled
def through(x: Floats, y: Floats, three: tuple[int, int, int]) -> tuple[float, float, float]:
    """The circle (u, v, radius) through three of the points.

    NaN or infinite if they lie on a line.
    """
    i, j, k = three
    xj, yj, xk, yk = x[j] - x[i], y[j] - y[i], x[k] - x[i], y[k] - y[i]
    det = 2.0 * (xj * yk - yj * xk)
    sj, sk = xj * xj + yj * yj, xk * xk + yk * yk
    a, b = (yk * sj - yj * sk) / det, (xj * sk - xk * sj) / det
    return x[i] + a, y[i] + b, np.sqrt(a * a + b * b)


@compiled
def agreement(x: Floats, y: Floats, circle: tuple[float, float, float]) -> float:
    """How many of every other point lie on a circle. A near one counts up to 1, an outer one -1."""
    a, b, radius = circle
    tolerance = max(0.04 * radius, 0.7)
    score = 0.0
    for i in range(0, x.size, 2):
        miss = (np.sqrt((x[i] - a) ** 2 + (y[i] - b) ** 2) - radius) / tolerance
        if abs(miss) < 1.0:
            score += 1.0 - miss * miss
        elif miss > 1.0:
            score -= 1.0  # nothing puts a point outside of a ball
    return score


@compiled
def robust_ellipse(distance: Floats, radius: float) -> tuple[Floats, float]:
    """The ellipse (r, dx, dy, e1, e2) through most of the points, and the spread of those about it.

    Iteratively reweighted least squares with Tukey's weights, their width taken from the spread.
    """
    fit = np.array([radius, 0.0, 0.0, 0.0, 0.0])
    gate, spread = max(0.08 * radius, 1.5), SHARPEST
    for _ in range(8):
        miss = missed(distance, fit)
        near = np.sort(np.abs(miss))
        count = np.searchsorted(near, gate)
        if count < 8:
            break
        spread = max(1.4826 * near[count // 2], SHARPEST)
        gate = min(gate, 4.0 * spread)
        prior = (max(spread, ALIKE) / (ELONGATION * radius)) ** 2
        fit = fit + correction(miss, fit, gate, prior)
    return fit, spread


@compiled
def missed(distance: Floats, fit: Floats) -> Floats:
    """How far each point lies outside of the ellipse; NaN where there is none."""
    miss = np.empty(RAYS)
    for i in range(RAYS):
        miss[i] = distance[i]
        for k in range(5):
            miss[i] -= ROWS[i, k] * fit[k]
    return miss


@compiled
def agreed(rays: Floats, ellipse: Floats) -> Floats:
    """How much each ray's point agrees with the ellipse whose rays they are, 0 to 1 (RAYS,)."""
    gate = max(1.5, 0.06 * ellipse[2])
    miss = missed(rays[0], np.array([ellipse[2], 0.0, 0.0, ellipse[3], ellipse[4]]))
    agrees = np.zeros(RAYS)
    for i in range(RAYS):
        if abs(miss[i]) < gate:
            agrees[i] = min(2.0 - 2.0 * abs(miss[i]) / gate, 1.0)
    return agrees


@compiled
def correction(miss: Floats, fit: Floats, gate: float, prior: float) -> Floats:
    """The least squares step of the fit. Points count the less the more they miss; beyond `gate`
    they count nothing."""
    N, b = np.zeros((5, 5)), np.zeros(5)
    for k in (3, 4):
        N[k, k], b[k] = prior, -prior * fit[k]
    for i in range(RAYS):
        if abs(miss[i]) < gate:
            weight = (1.0 - (miss[i] / gate) ** 2) ** 2
            for k in range(5):
                for l in range(5):
                    N[k, l] += weight * ROWS[i, k] * ROWS[i, l]
                b[k] += weight * ROWS[i, k] * miss[i]
    if not invert(N):
        fill(N, np.nan)
    return product(N, b)


@compiled
def supported(rays: Floats, ellipse: Floats, other: Floats) -> tuple[float, float]:
    """The fraction of the rays of an ellipse whose point lies on the `other` one, hardly elsewhere,
    and the median fall there.

    A point counts if its fall is about as large as the others'.
    """
    fit = np.array([other[2], other[0] - ellipse[0], other[1] - ellipse[1], other[3], other[4]])
    on = np.abs(missed(rays[0], fit)) < 0.4 + 0.02 * fit[0]
    if not on.any():
        return 0.0, 0.0
    contrast = float(np.median(rays[1][on]))
    return (rays[1][on] > 0.3 * contrast).sum() / RAYS, contrast
