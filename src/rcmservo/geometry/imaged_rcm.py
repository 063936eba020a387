"""Estimation of the imaged RCM o_c from lines of the imaged tool's axis, eq. (16).

Every frame gives one line through both markers. All lines pass through o_c, which eq. (16) computes
by least squares, with nᵢ the unit normal of line i and m̃₁ᵢ its raw marker 1:

    o_c = (Σ nᵢ nᵢᵀ)⁻¹ Σ nᵢ nᵢᵀ m̃₁ᵢ

The last H lines of a slow motion nearly coincide, and the solution then collapses onto the tool.
Three changes prevent this. Of H + 1 lines, the one with the least leverage on the solution is
removed, which preserves the extremes of angle. Each line has the weight d², because the angle of a
line through two points d apart is known to noise/d. A few Gauss-Newton steps lead to the point
whose lines pass nearest to the markers, because noise turns the normals and biases (16) towards the
tool. The argument `follows_paper` turns the three changes off.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from rcmservo.constraints import Checked, above, between
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into
from rcmservo.numerics.small_solvers import solve_2x2

MAX_LINES = 1000
"""Largest number of stored lines; each costs time at every new frame."""

MIN_MARKER_DISTANCE_PX = 1e-12
"""Smallest distance of the markers (px) that a normal is divided by."""

SINGULAR_CONDITION = 1e12
"""Condition of (16) from which the lines count as parallel."""

MAX_REFINED_CONDITION = 1e6
"""Condition of (16) up to which Gauss-Newton steps improve its solution."""


@dataclass(frozen=True)
class ImagedRcm(Checked, section="imaged_rcm"):
    """Estimation of the imaged RCM by eq. (16), the point nearest to the lines of the imaged tool.

    The line of frame i passes through both markers. With its unit normal nᵢ (2,) and its raw marker
    1, m̃₁ᵢ (2,) px, the imaged RCM o_c (2,) px is

        o_c = (Σ wᵢ nᵢ nᵢᵀ)⁻¹ Σ wᵢ nᵢ nᵢᵀ m̃₁ᵢ

    The weight wᵢ is the squared distance of the markers, and the sums contain the H most
    informative lines. Gauss-Newton steps then remove the bias that pixel noise causes. An instance
    is passed as the argument `imaged_rcm` of `Servo`.

    Parameters
    ----------
    lines : int
        H, the number of stored lines, from 2 to 1000.
    refinements : int
        Number of Gauss-Newton steps after (16), from 0 to 100, to the point whose lines pass
        nearest to the markers. The fit 'printed' makes none.
    max_condition : float
        Largest condition number of (16) at which o_c counts as known, above 1 and at most 1e12. It
        is about 1 / (variance of the line angle in rad²).
    fit : Literal['refined', 'printed']
        Fit; 'printed' is the paper's eq. (16) exactly: weight 1, the last H lines, no steps after
        it. As the tool comes to rest these lines coincide, and the run pauses because o_c is not
        known.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    The fit 'refined' differs from eq. (16) in three points:

    - Selection. The newest line is added to the H stored ones, and the line i with the least
      leverage dᵢ² nᵢᵀ N⁻¹ nᵢ is removed, with dᵢ px the distance of the markers and N (2, 2) px² =
      Σ dᵢ² nᵢ nᵢᵀ over all H + 1 lines. Its removal changes o_c least.
    - Weights. wᵢ = dᵢ², because pixel noise σ disturbs the angle of a line by √2 σ/dᵢ.
    - Steps. From the solution of (16), Gauss-Newton steps minimise the cost

          Q(o_c) = Σᵢ min over tᵢ of (e₁ᵢ² + e₂ᵢ²)    px²

      with e₁ᵢ and e₂ᵢ px the distances of both markers from the line through o_c in the direction
      tᵢ. Noise turns the normals, which biases (16) towards the tool; the steps remove this bias.
      From the condition number 1e6 of (16) on, no step is made.

    References
    ----------
    Section III-A of the paper for eq. (16). The selection, the weights and the steps are this
    project's own.
    """

    name = "lines"

    lines: Annotated[int, between(2, MAX_LINES, "a whole number of lines")] = 50
    refinements: Annotated[int, between(0, 100, "a whole number")] = 3
    max_condition: Annotated[float, above(1.0, 1e12)] = 2e4
    fit: Literal["refined", "printed"] = "refined"

    @property
    def printed(self) -> bool:
        """True if the solution is the paper's eq. (16) without changes."""
        return self.fit == "printed"

    def init(self) -> tuple[Floats, int]:
        """Return an empty memory: lines (H + 1, 4) px and their number, 0."""
        return np.zeros((self.lines + 1, 4)), 0


@compiled
def build_normal_equations(lines: Floats, count: int, follows_paper: bool) -> tuple[Floats, Floats]:
    """Return N = Σ w n nᵀ (2, 2) and b = Σ w n nᵀ m̃₁ (2,) of eq. (16), N o_c = b.

    The first `count` rows of `lines` hold raw pixels [u₁ v₁ u₂ v₂]. The weight w is d², or 1 if
    `follows_paper`.
    """
    N = np.zeros((2, 2))
    b = np.zeros(2)
    for i in range(count):
        # d n, with n the unit normal: its products carry the weight d².
        nu, nv = lines[i, 1] - lines[i, 3], lines[i, 2] - lines[i, 0]
        if follows_paper:
            d = max(np.sqrt(nu * nu + nv * nv), MIN_MARKER_DISTANCE_PX)
            nu, nv = nu / d, nv / d
        offset = nu * lines[i, 0] + nv * lines[i, 1]
        N[0, 0] += nu * nu
        N[0, 1] += nu * nv
        N[1, 1] += nv * nv
        b[0] += nu * offset
        b[1] += nv * offset
    N[1, 0] = N[0, 1]
    return N, b


@compiled
def compute_condition(N: Floats) -> float:
    """Return the condition number of a symmetric positive semidefinite N (2, 2).

    It is inf for a singular matrix.
    """
    half_trace = 0.5 * (N[0, 0] + N[1, 1])
    spread = np.sqrt((0.5 * (N[0, 0] - N[1, 1])) ** 2 + N[0, 1] ** 2)
    smallest_eigenvalue = half_trace - spread
    if not smallest_eigenvalue > 0.0:
        return np.inf
    return (half_trace + spread) / smallest_eigenvalue


@compiled
def intersect_lines(lines: Floats, count: int, follows_paper: bool) -> tuple[Floats, float]:
    """Return o_c (2,) px of eq. (16), the point nearest to all lines, and the condition of (16).

    The condition is about 1 / (variance of the line angle). For parallel lines o_c is NaN and the
    condition inf.
    """
    N, b = build_normal_equations(lines, count, follows_paper)
    condition = compute_condition(N)
    if not condition < SINGULAR_CONDITION:
        return np.full(2, np.nan), np.inf
    return solve_2x2(N, b), condition


@compiled
def compute_principal_direction(
    diagonal_difference: float, cross_term: float
) -> tuple[float, float]:
    """Return (cos θ, sin θ) of θ = ½ atan2(cross_term, diagonal_difference).

    θ is the main direction of points (x, y) whose scatter matrix has Σx² − Σy² =
    `diagonal_difference` and 2 Σxy = `cross_term` (or both in the same ratio). Points without a
    main direction give (1, 0).
    """
    size = np.sqrt(diagonal_difference * diagonal_difference + cross_term * cross_term)
    if size == 0.0:
        return 1.0, 0.0
    if diagonal_difference > 0.0:
        c = np.sqrt(0.5 * (size + diagonal_difference) / size)
        return c, 0.5 * cross_term / (size * c)
    s = np.sqrt(0.5 * (size - diagonal_difference) / size)
    return 0.5 * cross_term / (size * s), s


@compiled
def step_to_nearest_bundle(lines: Floats, count: int, o_c: Floats) -> Floats:
    """Return o_c (2,) px after one Gauss-Newton step to the bundle of lines nearest to all markers.

    Each line passes through o_c, in the direction t nearest to its two markers. These lie at the
    distances l₁, l₂ along the line and e₁, e₂ across it. The line leaves the residual
    (e₁ l₂ − e₂ l₁)/√(l₁² + l₂²). Its derivative by o_c is (l₂ − l₁)/√(l₁² + l₂²) along the normal.
    """
    N = np.zeros((2, 2))
    b = np.zeros(2)
    for i in range(count):
        u1, v1 = lines[i, 0] - o_c[0], lines[i, 1] - o_c[1]
        u2, v2 = lines[i, 2] - o_c[0], lines[i, 3] - o_c[1]
        half_difference = 0.5 * (u1 * u1 + u2 * u2 - v1 * v1 - v2 * v2)
        tu, tv = compute_principal_direction(half_difference, u1 * v1 + u2 * v2)
        l1, l2 = tu * u1 + tv * v1, tu * u2 + tv * v2
        e1, e2 = tu * v1 - tv * u1, tu * v2 - tv * u2
        squared = l1**2 + l2**2
        if squared == 0.0:
            continue
        weight, residual = (l2 - l1) ** 2 / squared, (e1 * l2 - e2 * l1) * (l2 - l1) / squared
        N[0, 0] += weight * tv * tv
        N[0, 1] -= weight * tu * tv
        N[1, 1] += weight * tu * tu
        b[0] -= residual * tv
        b[1] += residual * tu
    if not N[0, 0] * N[1, 1] - N[0, 1] ** 2 > 0.0:
        return o_c
    step = solve_2x2(N, b)
    return np.array([o_c[0] + step[0], o_c[1] + step[1]])


@compiled
def solve_imaged_rcm(
    lines: Floats, count: int, refinements: int, follows_paper: bool
) -> tuple[Floats, float]:
    """Return o_c (2,) px and the condition number of eq. (16).

    Unless `follows_paper`, `refinements` Gauss-Newton steps follow the solution of (16).
    """
    o_c, condition = intersect_lines(lines, count, follows_paper)
    if condition < MAX_REFINED_CONDITION and not follows_paper:
        for _ in range(refinements):
            o_c = step_to_nearest_bundle(lines, count, o_c)
    return o_c, condition


@compiled
def find_least_informative_line(lines: Floats, count: int) -> int:
    """Return the row of the line with the least leverage nᵀ (Σ n nᵀ)⁻¹ n on o_c.

    The removal of this line changes the solution least.
    """
    N, _ = build_normal_equations(lines, count, False)
    least_leverage, row = np.inf, 0
    for i in range(count):
        nu, nv = lines[i, 1] - lines[i, 3], lines[i, 2] - lines[i, 0]
        leverage = nu * nu * N[1, 1] - 2.0 * nu * nv * N[0, 1] + nv * nv * N[0, 0]
        if leverage < least_leverage:
            least_leverage, row = leverage, i
    return row


@compiled
def store_line(
    lines: Floats, count: int, points: Floats, follows_paper: bool
) -> tuple[Floats, int]:
    """Return the lines (H + 1, 4) and their number, with the line through `points` added.

    `points` (2, 2) are raw marker pixels. The last row is spare. If H lines are stored already, the
    least informative one is removed, or the oldest one if `follows_paper`.
    """
    lines = lines.copy()
    for k in range(4):
        lines[count, k] = points[k // 2, k % 2]
    if count < len(lines) - 1:
        return lines, count + 1
    if follows_paper:
        for i in range(count):
            copy_into(lines[i], lines[i + 1])
    else:
        row = find_least_informative_line(lines, count + 1)
        copy_into(lines[row], lines[count])
    return lines, count


@compiled
def update_imaged_rcm(
    lines: Floats, count: int, points: Floats, refinements: int, follows_paper: bool
) -> tuple[Floats, int, Floats, float]:
    """Add the line through raw marker pixels `points` (2, 2) and solve eq. (16).

    Return the lines (H + 1, 4), their number, o_c (2,) px and the condition number.
    """
    lines, count = store_line(lines, count, points, follows_paper)
    o_c, condition = solve_imaged_rcm(lines, count, refinements, follows_paper)
    return lines, count, o_c, condition
