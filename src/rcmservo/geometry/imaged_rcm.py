"""Where the camera sees the RCM: the point o_c nearest to the imaged tool's axis in many poses, eq.
(16).

The last H lines of a slow motion are almost one line, and (16) then collapses onto the tool. So a
line stays by what it says about o_c: of H + 1 lines the one with the least leverage on the solution
goes, which keeps the extremes of angle. A line through two points d apart is known to an angle of
noise/d, so lines are weighted by d².

Noise turns the normals n of (16), which pulls o_c towards the tool. So a few Gauss-Newton steps
follow, to the point whose bundle of lines passes nearest to the markers: that has no such bias, as
each line's direction then comes from o_c and both markers instead of from the markers alone.

``printed`` is eq. (16) as the paper has it: unit normals, the last H lines, no steps after it.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from rcmservo.constraints import Checked, above, between
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import put
from rcmservo.numerics.small_solvers import solve_2x2

MOST = 1000
"""Lines; each costs time at every new frame."""


@compiled
def normal_equations(lines: Floats, count: int, printed: bool) -> tuple[Floats, Floats]:
    """Σ w n nᵀ (2, 2) and Σ w n nᵀ m̃₁ (2,) of eq. (16) over `count` rows [u₁ v₁ u₂ v₂] of raw
    pixels; w is d², or 1 if as `printed`.
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
def condition_of(N: Floats) -> float:
    """Condition number of a symmetric positive semidefinite (2, 2) matrix; inf where it is
    singular.
    """
    half_trace = 0.5 * (N[0, 0] + N[1, 1])
    spread = np.sqrt((0.5 * (N[0, 0] - N[1, 1])) ** 2 + N[0, 1] ** 2)
    least = half_trace - spread
    if not least > 0.0:
        return np.inf
    return (half_trace + spread) / least


@compiled
def nearest_to_lines(lines: Floats, count: int, printed: bool) -> tuple[Floats, float]:
    """o_c (2,) px of eq. (16) and the condition number of its matrix, about 1 / var(line angle);
    NaN where singular.
    """
    N, b = normal_equations(lines, count, printed)
    condition = condition_of(N)
    if not condition < 1e12:
        return np.full(2, np.nan), np.inf
    return solve_2x2(N, b), condition


@compiled
def principal(along: float, across: float) -> tuple[float, float]:
    """(cos θ, sin θ) of the half angle θ = ½ atan2(across, along): the main direction of a scatter
    matrix.

    Where it has none, (1, 0).
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
def nearest_bundle(lines: Floats, count: int, o_c: Floats) -> Floats:
    """One Gauss-Newton step from o_c (2,) towards the point whose bundle of lines passes nearest to
    all markers.

    Each line's direction is fitted through o_c to both its markers, at distances l₁, l₂ along it
    and e₁, e₂ beside it. Turning it leaves (e₁ l₂ − e₂ l₁)/√(l₁² + l₂²), which o_c changes by (l₂ −
    l₁)/√(l₁² + l₂²) along the normal.
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
        tu, tv = principal(along, across)
        l1, l2 = tu * u1 + tv * v1, tu * u2 + tv * v2
        e1, e2 = tu * v1 - tv * u1, tu * v2 - tv * u2
        size = l1**2 + l2**2
        if size == 0.0:
            continue
        weight, left = (l2 - l1) ** 2 / size, (e1 * l2 - e2 * l1) * (l2 - l1) / size
        N[0, 0] += weight * tv * tv
        N[0, 1] -= weight * tu * tv
        N[1, 1] += weight * tu * tu
        b[0] -= left * tv
        b[1] += left * tu
    if not N[0, 0] * N[1, 1] - N[0, 1] ** 2 > 0.0:
        return o_c
    step = solve_2x2(N, b)
    return np.array([o_c[0] + step[0], o_c[1] + step[1]])


@compiled
def solve(lines: Floats, count: int, refinements: int, printed: bool) -> tuple[Floats, float]:
    """o_c (2,) px, eq. (16) and then, but if as `printed`, `refinements` steps to the nearest
    bundle; and the condition number of (16).
    """
    o_c, condition = nearest_to_lines(lines, count, printed)
    if condition < 1e6 and not printed:
        for _ in range(refinements):
            o_c = nearest_bundle(lines, count, o_c)
    return o_c, condition


@compiled
def least_telling(lines: Floats, count: int) -> int:
    """The row whose line has the least leverage nᵀ (Σ n nᵀ)⁻¹ n on o_c: what is lost least when it
    goes.
    """
    N, _ = normal_equations(lines, count, False)
    least, row = np.inf, 0
    for i in range(count):
        nu, nv = lines[i, 1] - lines[i, 3], lines[i, 2] - lines[i, 0]
        leverage = nu * nu * N[1, 1] - 2.0 * nu * nv * N[0, 1] + nv * nv * N[0, 0]
        if leverage < least:
            least, row = leverage, i
    return row


@compiled
def remember(lines: Floats, count: int, points: Floats, printed: bool) -> tuple[Floats, int]:
    """The lines (H + 1, 4) and their number after the line through raw `points` (2, 2) came; the
    last row is spare. The most telling lines stay, or the last ones if as `printed`.
    """
    lines = lines.copy()
    for k in range(4):
        lines[count, k] = points[k // 2, k % 2]
    if count < len(lines) - 1:
        return lines, count + 1
    if printed:
        for i in range(count):
            put(lines[i], lines[i + 1])
    else:
        row = least_telling(lines, count + 1)
        put(lines[row], lines[count])
    return lines, count


@compiled
def follow(
    lines: Floats, count: int, points: Floats, refinements: int, printed: bool
) -> tuple[Floats, int, Floats, float]:
    """The lines and their number after raw `points` (2, 2) came, and `solve` of them."""
    lines, count = remember(lines, count, points, printed)
    o_c, condition = solve(lines, count, refinements, printed)
    return lines, count, o_c, condition


@dataclass(frozen=True)
class ImagedRcm(Checked, section="imaged_rcm"):
    """How the imaged RCM is computed: eq. (16) over the most telling lines, then refined; or as
    printed.

    Parameters
    ----------
    lines : int
        H, the number of lines kept.
    refinements : int
        Gauss-Newton steps after (16), to the nearest bundle of lines; none if as printed.
    max_condition : float
        Condition of (16), about 1 / variance of the line angle (1/rad²), above which o_c is not yet
        observable.
    fit : Literal['refined', 'printed']
        Printed is eq. (16) exactly: unit normals, the last H lines, no steps after it. As the tool
        comes to rest these lines are one, and the run pauses because o_c is not known.
    """

    name = "lines"

    lines: Annotated[int, between(2, MOST, "a whole number of lines")] = 50
    refinements: Annotated[int, between(0, 100, "a whole number")] = 3
    max_condition: Annotated[float, above(1.0, 1e12)] = 2e4
    fit: Literal["refined", "printed"] = "refined"

    @property
    def printed(self) -> bool:
        """Whether it is eq. (16) as printed."""
        return self.fit == "printed"

    def init(self) -> tuple[Floats, int]:
        """No line seen yet."""
        return np.zeros((self.lines + 1, 4)), 0
