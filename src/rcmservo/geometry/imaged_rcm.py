"""Estimation of the imaged RCM o_c from lines of the imaged tool's axis, eq. (16).

The last H lines of a slow motion nearly coincide, and the solution of (16) then collapses onto the
tool. Lines are therefore stored by their information about o_c: of H + 1 lines, the one with the
least leverage on the solution is removed, which preserves the extremes of angle. The angle of a
line through two points d apart is known to noise/d, so each line has the weight d².

Noise turns the normals n of (16), which biases o_c towards the tool. A few Gauss-Newton steps
follow, to the point whose bundle of lines passes nearest to the markers. This point has no such
bias, because the direction of each line then comes from o_c and both markers instead of the markers
alone.

With ``printed``, the solution is eq. (16) as the paper has it: unit normals, the last H lines, no
further steps.
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


@compiled
def build_normal_equations(lines: Floats, count: int, printed: bool) -> tuple[Floats, Floats]:
    """Return Σ w n nᵀ (2, 2) and Σ w n nᵀ m̃₁ (2,) of eq. (16).

    The first `count` rows of `lines` hold raw pixels [u₁ v₁ u₂ v₂]. The weight w is d², or 1 if
    `printed`.
    """
    N = np.zeros((2, 2))
    b = np.zeros(2)
    for i in range(count):
        # d n, with n the unit normal: its products carry the weight d².
        nu, nv = lines[i, 1] - lines[i, 3], lines[i, 2] - lines[i, 0]
        if printed:
            size = max(np.sqrt(nu * nu + nv * nv), 1e-12)
            nu, nv = nu / size, nv / size
        along = nu * lines[i, 0] + nv * lines[i, 1]
        N[0, 0] += nu * nu
        N[0, 1] += nu * nv
        N[1, 1] += nv * nv
        b[0] += nu * along
        b[1] += nv * along
    N[1, 0] = N[0, 1]
    return N, b


@compiled
def compute_condition(N: Floats) -> float:
    """Return the condition number of a symmetric positive semidefinite N (2, 2).

    It is inf for a singular matrix.
    """
    half_trace = 0.5 * (N[0, 0] + N[1, 1])
    spread = np.sqrt((0.5 * (N[0, 0] - N[1, 1])) ** 2 + N[0, 1] ** 2)
    least = half_trace - spread
    if not least > 0.0:
        return np.inf
    return (half_trace + spread) / least


@compiled
def intersect_lines(lines: Floats, count: int, printed: bool) -> tuple[Floats, float]:
    """Return o_c (2,) px of eq. (16), the point nearest to all lines, and the condition of (16).

    The condition is about 1 / var(line angle). For a singular matrix o_c is NaN and the condition
    inf.
    """
    N, b = build_normal_equations(lines, count, printed)
    condition = compute_condition(N)
    if not condition < 1e12:
        return np.full(2, np.nan), np.inf
    return solve_2x2(N, b), condition


@compiled
def compute_principal_direction(along: float, across: float) -> tuple[float, float]:
    """Return (cos θ, sin θ) of θ = ½ atan2(across, along), the main direction of a scatter matrix.

    A scatter matrix without a main direction gives (1, 0).
    """
    size = np.sqrt(along * along + across * across)
    if size == 0.0:
        return 1.0, 0.0
    if along > 0.0:
        c = np.sqrt(0.5 * (size + along) / size)
        return c, 0.5 * across / (size * c)
    s = np.sqrt(0.5 * (size - along) / size)
    return 0.5 * across / (size * s), s


@compiled
def step_to_nearest_bundle(lines: Floats, count: int, o_c: Floats) -> Floats:
    """Return o_c (2,) px after one Gauss-Newton step to the bundle of lines nearest to all markers.

    Each line's direction is fitted through o_c to both its markers, at distances l₁, l₂ along the
    line and e₁, e₂ across it. The fitted direction leaves the residual (e₁ l₂ − e₂ l₁)/√(l₁² +
    l₂²), whose derivative by o_c is (l₂ − l₁)/√(l₁² + l₂²) along the normal.
    """
    N = np.zeros((2, 2))
    b = np.zeros(2)
    for i in range(count):
        u1, v1, u2, v2 = (
            lines[i, 0] - o_c[0],
            lines[i, 1] - o_c[1],
            lines[i, 2] - o_c[0],
            lines[i, 3] - o_c[1],
        )
        across, along = u1 * v1 + u2 * v2, 0.5 * (u1 * u1 + u2 * u2 - v1 * v1 - v2 * v2)
        tu, tv = compute_principal_direction(along, across)
        l1, l2 = tu * u1 + tv * v1, tu * u2 + tv * v2
        e1, e2 = tu * v1 - tv * u1, tu * v2 - tv * u2
        size = l1**2 + l2**2
        if size == 0.0:
            continue
        weight, residual = (l2 - l1) ** 2 / size, (e1 * l2 - e2 * l1) * (l2 - l1) / size
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
    lines: Floats, count: int, refinements: int, printed: bool
) -> tuple[Floats, float]:
    """Return o_c (2,) px and the condition number of eq. (16).

    The solution of (16) is followed by `refinements` steps to the nearest bundle, unless `printed`.
    """
    o_c, condition = intersect_lines(lines, count, printed)
    if condition < 1e6 and not printed:
        for _ in range(refinements):
            o_c = step_to_nearest_bundle(lines, count, o_c)
    return o_c, condition


@compiled
def find_least_informative_line(lines: Floats, count: int) -> int:
    """Return the row of the line with the least leverage nᵀ (Σ n nᵀ)⁻¹ n on o_c.

    The removal of this line changes the solution least.
    """
    N, _ = build_normal_equations(lines, count, False)
    least, row = np.inf, 0
    for i in range(count):
        nu, nv = lines[i, 1] - lines[i, 3], lines[i, 2] - lines[i, 0]
        leverage = nu * nu * N[1, 1] - 2.0 * nu * nv * N[0, 1] + nv * nv * N[0, 0]
        if leverage < least:
            least, row = leverage, i
    return row


@compiled
def store_line(lines: Floats, count: int, points: Floats, printed: bool) -> tuple[Floats, int]:
    """Return the lines (H + 1, 4) and their number, with the line through `points` added.

    `points` (2, 2) are raw marker pixels. The last row is spare. Where H lines are stored already,
    the least informative one is removed, or the oldest one if `printed`.
    """
    lines = lines.copy()
    for k in range(4):
        lines[count, k] = points[k // 2, k % 2]
    if count < len(lines) - 1:
        return lines, count + 1
    if printed:
        for i in range(count):
            copy_into(lines[i], lines[i + 1])
    else:
        row = find_least_informative_line(lines, count + 1)
        copy_into(lines[row], lines[count])
    return lines, count


@compiled
def update_imaged_rcm(
    lines: Floats, count: int, points: Floats, refinements: int, printed: bool
) -> tuple[Floats, int, Floats, float]:
    """Add the line through raw marker pixels `points` (2, 2) and solve eq. (16).

    Return the lines (H + 1, 4), their number, o_c (2,) px and the condition number.
    """
    lines, count = store_line(lines, count, points, printed)
    o_c, condition = solve_imaged_rcm(lines, count, refinements, printed)
    return lines, count, o_c, condition


@dataclass(frozen=True)
class ImagedRcm(Checked, section="imaged_rcm"):
    """Estimation of the imaged RCM by eq. (16), over the most informative lines and refined.

    Parameters
    ----------
    lines : int
        H, the number of stored lines, from 2 to 1000.
    refinements : int
        Gauss-Newton steps after (16), from 0 to 100, to the nearest bundle of lines; not used by
        the printed fit.
    max_condition : float
        Largest condition of (16), about 1 / variance of the line angle (1/rad²), above 1, at which
        o_c counts as observable.
    fit : Literal['refined', 'printed']
        Printed is eq. (16) exactly: unit normals, the last H lines, no steps after it. As the tool
        comes to rest these lines coincide, and the run pauses because o_c is not known.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    References
    ----------
    Section III-A of the paper.
    """

    name = "lines"

    lines: Annotated[int, between(2, MAX_LINES, "a whole number of lines")] = 50
    refinements: Annotated[int, between(0, 100, "a whole number")] = 3
    max_condition: Annotated[float, above(1.0, 1e12)] = 2e4
    fit: Literal["refined", "printed"] = "refined"

    @property
    def printed(self) -> bool:
        """True if the solution is eq. (16) as printed."""
        return self.fit == "printed"

    def init(self) -> tuple[Floats, int]:
        """Return an empty memory: lines (H + 1, 4) px and their number, 0."""
        return np.zeros((self.lines + 1, 4)), 0
