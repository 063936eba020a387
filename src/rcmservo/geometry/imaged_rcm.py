"""Estimation of the imaged RCM o_c from lines of the imaged tool's axis, eq. (16).

Every frame gives one line through both markers. All lines pass through o_c, which eq. (16) computes
by least squares, with nᵢ the unit normal of line i and m̃₁ᵢ its raw marker 1:

    o_c = (Σ nᵢ nᵢᵀ)⁻¹ Σ nᵢ nᵢᵀ m̃₁ᵢ

The last H lines of a slow motion nearly coincide. Noise then turns their normals more than the
motion does, and the solution collapses onto the tool. Two changes prevent this: all lines enter,
and the noise is subtracted. The line through the pixels (u₁, v₁) and (u₂, v₂) is the cross product

    l = [u₁ v₁ 1] × [u₂ v₂ 1],    [o_c 1]·l = 0

whose first two entries are a normal of the length d, the distance of the markers. Noise of the
variance σ² in each pixel coordinate adds σ²C to the expectation of M, with

    M = Σ l lᵀ,    C = Σ [ 2  0  −(u₁ + u₂) ;  0  2  −(v₁ + v₂) ;  ·  ·  u₁² + v₁² + u₂² + v₂² ]

σ² is the smallest solution of det(M − σ²C) = 0, and the first two rows of (M − σ²C)[o_c 1] = 0 are
eq. (16) with the weights d² and without the noise. The sums M and C are all that is stored.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np

from rcmservo.constraints import Checked, above, between
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into
from rcmservo.numerics.small_solvers import solve_2x2

MAX_LINES = 1000
"""Largest number of lines of the printed fit; each costs time at every new frame."""

MIN_MARKER_DISTANCE_PX = 1e-12
"""Smallest distance of the markers (px) that a normal is divided by."""

SINGULAR_CONDITION = 1e12
"""Condition of (16) from which the lines count as parallel."""

MAX_NEWTON_STEPS = 30
"""Largest number of steps to the smallest root of det(M − σ²C); three to eight are usual."""

RELATIVE_ROOT_ERROR = 1e-9
"""Relative size of a step at which the root counts as found."""

PRIOR_NOISE_PX = 0.5
"""Expected noise (px) before the lines show it."""

PRIOR_NOISE_LINES = 5.0
"""Weight of the expected noise, as a number of lines."""


@dataclass(frozen=True)
class ImagedRcm(Checked, section="imaged_rcm"):
    """Estimation of the imaged RCM by eq. (16), the point nearest to the lines of the imaged tool.

    The line of frame i passes through both markers. With its unit normal nᵢ (2,), its raw marker 1,
    m̃₁ᵢ (2,) px, and the distance dᵢ px of its markers, the imaged RCM o_c (2,) px is

        o_c = (Σ dᵢ² nᵢ nᵢᵀ − 2nσ²I)⁻¹ Σ (dᵢ² nᵢ nᵢᵀ m̃₁ᵢ − σ² (m̃₁ᵢ + m̃₂ᵢ))

    over all n lines, which is (16) without the part of the noise. An instance is passed as the
    argument `imaged_rcm` of `Servo`.

    Parameters
    ----------
    lines : int
        H, the number of lines of the fit 'printed', from 2 to 1000.
    max_condition : float
        Largest condition number of (16) at which o_c of the fit 'printed' counts as known, above 1
        and at most 1e12. It is about 1 / (variance of the line angle in rad²).
    max_deviation : float
        Largest standard deviation of o_c, as a ratio of its distance from marker 1, at which o_c
        of the fit 'refined' counts as known, above 0 and at most 10.
    fit : Literal['refined', 'printed']
        Fit; 'printed' is the paper's eq. (16) exactly: weight 1, the last H lines, noise included.
        As the tool comes to rest these lines coincide, and the run pauses because o_c is not known.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    The fit 'refined' differs from eq. (16) in three points:

    - Lines. All lines enter. A servo takes one at every 0.3 mm of motion, so that a tool at rest
      does not outweigh the motion before.
    - Weights. The weight is dᵢ², because pixel noise σ disturbs the angle of a line by √2 σ/dᵢ.
    - Noise. The variance σ² of the noise in each pixel coordinate follows from the lines
      themselves, as the smallest σ² at which one point lies on all lines. Without its terms, noise
      turns the normals and biases (16) towards the tool.

    References
    ----------
    Section III-A of the paper for eq. (16). The noise is subtracted as by G. Taubin, "Estimation of
    planar curves, surfaces, and nonplanar space curves defined by implicit equations", IEEE Trans.
    Pattern Analysis and Machine Intelligence 13 (1991).
    """

    name = "lines"

    lines: Annotated[int, between(2, MAX_LINES, "a whole number of lines")] = 50
    max_condition: Annotated[float, above(1.0, 1e12)] = 2e4
    max_deviation: Annotated[float, above(0.0, 10.0, "a ratio")] = 0.5
    fit: Literal["refined", "printed"] = "refined"

    @property
    def printed(self) -> bool:
        """True if the solution is the paper's eq. (16) without changes."""
        return self.fit == "printed"

    def init(self) -> tuple[Floats, int]:
        """Return an empty memory and the number of its lines, 0.

        The memory of the fit 'printed' is its lines (H, 4) px, else the sums (7, 3) of `add_line`.
        """
        return np.zeros((self.lines, 4) if self.printed else (7, 3)), 0

    def knows(self, solution: "RcmSolution", m1: Floats) -> bool:
        """Return True if o_c counts as known, with the raw marker 1 at `m1` (2,) px."""
        limits = self.max_condition, self.max_deviation
        return bool(compute_uncertainty(solution, m1, *limits, self.printed) <= 1.0)


class RcmSolution(NamedTuple):
    """Solution of eq. (16).

    Parameters
    ----------
    o_c : Floats
        Imaged RCM (2,) px; NaN for parallel lines.
    covariance : Floats
        Covariance (2, 2) px² of o_c from the noise of the markers; NaN for the printed fit.
    condition : float
        Condition number, about 1 / (variance of the line angle); inf for parallel lines.
    """

    o_c: Floats
    covariance: Floats
    condition: float


@compiled
def add_line(sums: Floats, points: Floats) -> None:
    """Add the line through raw marker pixels `points` (2, 2) to the `sums` (7, 3).

    Rows 0 to 2 are M, rows 3 to 5 are C. Both are about the first marker 1, which is in row 6: far
    from the markers, rounding errors would grow with the squared distance.
    """
    if sums[3, 0] == 0.0:
        sums[6, 0], sums[6, 1] = points[0, 0], points[0, 1]
    u1, v1 = points[0, 0] - sums[6, 0], points[0, 1] - sums[6, 1]
    u2, v2 = points[1, 0] - sums[6, 0], points[1, 1] - sums[6, 1]
    line = v1 - v2, u2 - u1, u1 * v2 - u2 * v1
    for i in range(3):
        for j in range(3):
            sums[i, j] += line[i] * line[j]
    sums[3, 0] += 2.0
    sums[4, 1] += 2.0
    sums[3, 2] -= u1 + u2
    sums[4, 2] -= v1 + v2
    sums[5, 0], sums[5, 1] = sums[3, 2], sums[4, 2]
    sums[5, 2] += u1 * u1 + v1 * v1 + u2 * u2 + v2 * v2


@compiled
def sum_lines(lines: Floats) -> Floats:
    """Return the sums (7, 3) over `lines` (n, 4), rows [u₁ v₁ u₂ v₂] of raw pixels."""
    sums = np.zeros((7, 3))
    for i in range(len(lines)):
        add_line(sums, lines[i].copy().reshape((2, 2)))
    return sums


@compiled
def compute_adjugate(A: Floats) -> Floats:
    """Return the adjugate of a symmetric A (3, 3), which is det(A) A⁻¹."""
    adjugate = np.empty((3, 3))
    for i in range(3):
        for j in range(i, 3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            adjugate[i, j] = A[a, c] * A[b, d] - A[a, d] * A[b, c]
            adjugate[j, i] = adjugate[i, j]
    return adjugate


@compiled
def estimate_noise_variance(sums: Floats) -> float:
    """Return the smallest σ² (px²) with det(M − σ²C) = 0, by Newton's method.

    All roots are real, so that the steps from 0 approach the smallest one from below.
    """
    M, C, variance = sums[:3], sums[3:6], 0.0
    for _ in range(MAX_NEWTON_STEPS):
        A = M - variance * C
        adjugate = compute_adjugate(A)
        determinant, slope = 0.0, 0.0
        for i in range(3):
            determinant += A[0, i] * adjugate[0, i]
            for j in range(3):
                slope += adjugate[i, j] * C[i, j]
        if not (determinant > 0.0 and slope > 0.0):
            break
        step = determinant / slope
        variance += step
        if step < RELATIVE_ROOT_ERROR * variance:
            break
    return variance


@compiled
def compute_eigenvalues(N: Floats) -> tuple[float, float]:
    """Return the smaller and the larger eigenvalue of a symmetric N (2, 2)."""
    half_trace = 0.5 * (N[0, 0] + N[1, 1])
    spread = np.sqrt((0.5 * (N[0, 0] - N[1, 1])) ** 2 + N[0, 1] ** 2)
    return half_trace - spread, half_trace + spread


@compiled
def solve_normal_equations(N: Floats, b: Floats) -> tuple[Floats, float]:
    """Return o_c (2,) px of N o_c = b, and the condition of N (2, 2); NaN and inf if singular."""
    smallest, largest = compute_eigenvalues(N)
    if not SINGULAR_CONDITION * smallest > largest:
        return np.full(2, np.nan), np.inf
    return solve_2x2(N, b), largest / smallest


@compiled
def compute_covariance(C: Floats, variance: float, N: Floats, o_c: Floats) -> Floats:
    """Return the covariance (2, 2) px² of o_c (2,), from the origin of C; NaN for parallel lines.

    The distance of a line from o_c, times d, has the mean variance σ² [o_c 1] C [o_c 1]/n. The
    residuals of n lines show σ² with n − 2 degrees of freedom.
    """
    count, covariance = 0.5 * C[0, 0], np.full((2, 2), np.nan)
    if not compute_eigenvalues(N)[0] > 0.0:
        return covariance
    total = variance * count + PRIOR_NOISE_LINES * PRIOR_NOISE_PX**2
    noise_variance = total / (count - 2.0 + PRIOR_NOISE_LINES)
    spread = C[2, 2]
    for i in range(2):
        spread += o_c[i] * (C[i, i] * o_c[i] + 2.0 * C[i, 2])
    scale = noise_variance * spread / count / (N[0, 0] * N[1, 1] - N[0, 1] * N[1, 0])
    covariance[0, 0], covariance[1, 1] = scale * N[1, 1], scale * N[0, 0]
    covariance[0, 1] = covariance[1, 0] = -scale * N[0, 1]
    return covariance


@compiled
def solve_sums(sums: Floats) -> RcmSolution:
    """Return the solution of eq. (16) by the `sums` (7, 3) over all lines, without the noise."""
    C, variance = sums[3:6], estimate_noise_variance(sums)
    exact = sums[:3] - variance * C
    N = exact[:2, :2].copy()
    o_c, condition = solve_normal_equations(N, -exact[:2, 2])
    covariance = compute_covariance(C, variance, N, o_c)
    o_c[0] += sums[6, 0]
    o_c[1] += sums[6, 1]
    return RcmSolution(o_c, covariance, condition)


@compiled
def intersect_lines(lines: Floats) -> RcmSolution:
    """Return the solution of the paper's eq. (16) over `lines` (n, 4), rows [u₁ v₁ u₂ v₂] in px."""
    N, b = np.zeros((2, 2)), np.zeros(2)
    for i in range(len(lines)):
        nu, nv = lines[i, 1] - lines[i, 3], lines[i, 2] - lines[i, 0]
        d = max(np.sqrt(nu * nu + nv * nv), MIN_MARKER_DISTANCE_PX)
        nu, nv = nu / d, nv / d
        offset = nu * lines[i, 0] + nv * lines[i, 1]
        N[0, 0] += nu * nu
        N[0, 1] += nu * nv
        N[1, 1] += nv * nv
        b[0] += nu * offset
        b[1] += nv * offset
    N[1, 0] = N[0, 1]
    o_c, condition = solve_normal_equations(N, b)
    return RcmSolution(o_c, np.full((2, 2), np.nan), condition)


@compiled
def store_line(lines: Floats, count: int, points: Floats) -> int:
    """Store the line through raw marker pixels `points` (2, 2) as the newest of H `lines` (H, 4).

    Return the number of stored lines; the oldest one of H is removed.
    """
    if count == len(lines):
        count -= 1
        for i in range(count):
            copy_into(lines[i], lines[i + 1])
    for k in range(4):
        lines[count, k] = points[k // 2, k % 2]
    return count + 1


@compiled
def compute_uncertainty(
    solution: RcmSolution,
    m1: Floats,
    max_condition: float,
    max_deviation: float,
    follows_paper: bool,
) -> float:
    """Return the uncertainty of o_c as a ratio of its limit; NaN or above 1 if o_c is not known.

    `m1` (2,) is the raw marker 1 in px. The limits are those of `ImagedRcm`.
    """
    if follows_paper:
        return solution.condition / max_condition
    o_c, covariance = solution.o_c, solution.covariance
    distance = np.sqrt((m1[0] - o_c[0]) ** 2 + (m1[1] - o_c[1]) ** 2)
    return np.sqrt(covariance[0, 0] + covariance[1, 1]) / (max_deviation * distance)


@compiled
def update_imaged_rcm(
    memory: Floats, count: int, points: Floats, follows_paper: bool
) -> tuple[Floats, int, RcmSolution]:
    """Add the line through raw marker pixels `points` (2, 2) and solve eq. (16).

    Return a new memory, that of `ImagedRcm.init`, the number of its lines, and the solution.
    """
    memory = memory.copy()
    if follows_paper:
        count = store_line(memory, count, points)
        return memory, count, intersect_lines(memory[:count])
    add_line(memory, points)
    return memory, count + 1, solve_sums(memory)
