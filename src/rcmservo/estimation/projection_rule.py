"""Projection-based estimation, eq. (17)-(25): fit the nine parameters â to P chosen observations,
build Ĵ from â.

(21) is the linear ODE dâ/dt = −Γ (MᵀM â − Mᵀm), stable for any constant symmetric positive definite
Γ (Proposition 1), and here it is integrated exactly over any time (gradient_flow.py). Two choices
of Γ:
``printed`` is the paper's Γ₀ = diag(1e-5 I₆, 1e-8 I₃), a slow solver: its slowest mode needs hours.
``fast`` is Γ = η (MᵀM + ε Γ₀⁻¹)⁻¹, for which every well-observed mode decays at the rate η.

Observations are chosen for excitation: of P + 1 the one with the least leverage on â goes, so that
the path's extremes stay. It goes after the step, so that Γ, M and the choice share one factor. Raw
pixels are kept, so that all observations follow the imaged RCM when it moves.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np

from rcmservo.constraints import at_least, between, not_negative, positive
from rcmservo.estimation.base import Estimated, Estimator, KernelSample, Sample
from rcmservo.estimation.projection_fit import Prospect
from rcmservo.geometry.features import about, features_jacobian
from rcmservo.geometry.projection import PARAMETERS, depth, project, project_jacobian
from rcmservo.geometry.tool import Shaft, Tool, second_marker, second_marker_jacobian, stretch
from rcmservo.interfaces import Floats
from rcmservo.numerics.gradient_flow import decay
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import products, put

GAMMA_0 = np.array([1e-5] * 6 + [1e-8] * 3)
"""Diagonal of the printed Γ, for p in mm and m in px."""

MAX_DECAY = 1e5
"""Largest η t of the fast Γ: far beyond, rounding lets modes that were never observed grow."""

MOST = 1000
"""Observations; each costs time at every new frame."""

LEAST_EPSILON = 1e-10
"""Smallest ε, with which (MᵀM + ε Γ₀⁻¹) still has a root."""

MIN_DEPTH = 0.1
"""Smallest relative depth ẑ that an estimate may give to an observation: behind it the projection
turns over."""


@compiled
def sights(observations: Floats, count: int, o_c: Floats, both: bool, shaft: Shaft) -> Floats:
    """What is fitted, one point a row: [p (3) mm, its pixels (2) from o_c]. First marker 1 of all
    observations, then marker 2 if ``both`` are fitted.
    """
    rows = np.empty((2 * count if both else count, 5))
    for i in range(count):
        seen = observations[i]
        reach = stretch(shaft, seen[:3])
        for k in range(3):
            rows[i, k] = seen[k]
            if both:
                rows[count + i, k] = reach * seen[k]
        for k in range(2):
            rows[i, 3 + k] = seen[3 + k] - o_c[k]
            if both:
                rows[count + i, 3 + k] = seen[5 + k] - o_c[k]
    return rows


@compiled
def normal_equations(sights: Floats) -> tuple[Floats, Floats]:
    """MᵀM (9, 9) and Mᵀm (9,) of eq. (23)-(24): sums over the points of p pᵀ and p, each by itself
    and times u, v and u² + v², put where eq. (19) has them.
    """
    squares, firsts = np.zeros((4, 3, 3)), np.zeros((4, 3))
    for row in range(len(sights)):
        u, v = sights[row, 3], sights[row, 4]
        weights = (1.0, u, v, u * u + v * v)
        for i in range(3):
            for k in range(4):
                firsts[k, i] += weights[k] * sights[row, i]
            for j in range(3):
                square = sights[row, i] * sights[row, j]
                for k in range(4):
                    squares[k, i, j] += weights[k] * square
    A, b = np.zeros((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS)
    for i in range(3):
        b[i], b[3 + i], b[6 + i] = firsts[1, i], firsts[2, i], -firsts[3, i]
        for j in range(3):
            A[i, j], A[3 + i, 3 + j] = squares[0, i, j], squares[0, i, j]
            A[i, 6 + j], A[6 + i, j] = -squares[1, i, j], -squares[1, i, j]
            A[3 + i, 6 + j], A[6 + i, 3 + j] = -squares[2, i, j], -squares[2, i, j]
            A[6 + i, 6 + j] = squares[3, i, j]
    return A, b


@compiled
def leverage(inverse: Floats, both: Floats, sight: Floats) -> float:
    """tr(W A⁻¹ Wᵀ) of one point, by the blocks of A⁻¹ (9, 9); ``both`` is the sum of its first two
    on the diagonal.
    """
    u, v = sight[3], sight[4]
    far, total = u * u + v * v, 0.0
    for i in range(3):
        for j in range(3):
            block = both[i, j] + far * inverse[6 + i, 6 + j]
            cross = u * inverse[i, 6 + j] + v * inverse[3 + i, 6 + j]
            total += sight[i] * sight[j] * (block - 2.0 * cross)
    return total


@compiled
def least_telling(sights: Floats, count: int, root: Floats) -> int:
    """The one of `count` observations with the least leverage tr(W root rootᵀ Wᵀ) on â, where root
    rootᵀ = (MᵀM + εΓ₀⁻¹)⁻¹.
    """
    inverse = products(root, root.T)
    both = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            both[i, j] = inverse[i, j] + inverse[3 + i, 3 + j]
    shares = np.zeros(count)
    for row in range(len(sights)):
        shares[row % count] += leverage(inverse, both, sights[row])
    row = 0
    for i in range(count):
        if shares[i] < shares[row]:
            row = i
    return row


@compiled
def inverse_root(A: Floats, epsilon: float) -> Floats:
    """L⁻ᵀ (9, 9) with L Lᵀ = MᵀM + ε Γ₀⁻¹, by forward substitution: its product with its transpose
    is the inverse. Γ needs this root, which `numerics.small_solvers.invert` does not give.
    """
    regularised = A.copy()
    for i in range(PARAMETERS):
        regularised[i, i] += epsilon / GAMMA_0[i]
    L = np.linalg.cholesky(regularised)
    root = np.zeros((PARAMETERS, PARAMETERS))
    for column in range(PARAMETERS):
        root[column, column] = 1.0 / L[column, column]
        for i in range(column + 1, PARAMETERS):
            total = 0.0
            for j in range(column, i):
                total -= L[i, j] * root[column, j]
            root[column, i] = total / L[i, i]
    return root


@compiled
def keep_in_front(
    a: Floats, a_next: Floats, observations: Floats, count: int, shaft: Shaft
) -> Floats:
    """a_next, or the last point on the way to it from a at which every ẑ is at least MIN_DEPTH.

    ẑ is linear in â and U is convex, so that U (22) falls on the shortened step too.
    """
    step = 1.0
    for i in range(count):
        p1 = observations[i, :3]
        z, z_next = depth(a, p1), depth(a_next, p1)
        for reach in (1.0, stretch(shaft, p1)):
            here, there = 1.0 + reach * (z - 1.0), 1.0 + reach * (z_next - 1.0)
            if there < MIN_DEPTH:
                step = min(step, max((here - MIN_DEPTH) / (here - there), 0.0))
    kept = np.empty(len(a))
    for k in range(len(a)):
        kept[k] = a[k] + step * (a_next[k] - a[k])
    return kept


@compiled
def root_of_gamma(root: Floats, rate: float) -> Floats:
    """C (9, 9) with Γ = C Cᵀ: fast by the `root` of the inverse and η = `rate`, printed if that is
    0.
    """
    C = np.zeros((PARAMETERS, PARAMETERS))
    for i in range(PARAMETERS):
        C[i, i] = np.sqrt(GAMMA_0[i])
        for j in range(PARAMETERS):
            if rate > 0.0:
                C[i, j] = np.sqrt(rate) * root[i, j]
    return C


class ProjectionMemory(NamedTuple):
    """The chosen observations, and what was fitted to them.

    Parameters
    ----------
    observations : Floats
        (P + 1, 7) rows [p₁ mm, raw m₁ m₂ px]; the last is spare.
    filled : int
        How many rows are used, from the first on.
    a_hat : Floats
        â (9,); zeros at first.
    """

    observations: Floats
    filled: int
    a_hat: Floats


@compiled
def update(
    memory: ProjectionMemory,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    dt: float,
    rule: "Rule",
    shaft: Shaft,
) -> ProjectionMemory:
    """Take in one observation, dt s after the last one, and integrate (21) over the rule's time."""
    t = rule.time if rule.time > 0.0 else dt
    if rule.rate > 0.0:
        t = min(t, MAX_DECAY / rule.rate)
    observations, a, count = memory.observations.copy(), memory.a_hat, memory.filled + 1
    newest = observations[count - 1]
    put(newest[:3], p1)
    put(newest[3:], points.copy().reshape(4))
    fitted = sights(observations, count, o_c, rule.both, shaft)
    A, b = normal_equations(fitted)
    root = inverse_root(A, rule.epsilon)
    C = root_of_gamma(root, rule.rate)
    a_next = keep_in_front(a, decay(A, b, a, C, t), observations, count, shaft)
    if count == len(observations):
        row = least_telling(fitted, count, root)
        count -= 1
        put(observations[row], observations[count])
    return ProjectionMemory(observations, count, a_next)


@compiled
def markers_jacobian(a: Floats, p1: Floats, shaft: Shaft) -> Floats:
    """∂m/∂p₁ (4, 3), the second factor of eq. (15), of both markers."""
    p2, jacobian = second_marker(shaft, p1), np.empty((4, 3))
    put(jacobian[:2], project_jacobian(a, p1))
    put(jacobian[2:], products(project_jacobian(a, p2), second_marker_jacobian(shaft, p1)))
    return jacobian


@compiled
def feature_jacobian(a: Floats, p1: Floats, m: Floats, shaft: Shaft) -> Floats:
    """Ĵ (3, 3) of eq. (15): ∂y/∂m at the measured m, ∂m/∂p₁ from the parameters a."""
    return products(features_jacobian(m), markers_jacobian(a, p1, shaft))


@compiled
def jacobian_at(a: Floats, p1: Floats, points: Floats, o_c: Floats, shaft: Shaft) -> Floats:
    """`feature_jacobian` at raw `points` (2, 2) px."""
    return feature_jacobian(a, p1, about(points, o_c), shaft)


@compiled
def update_kernel(
    kernel: "Rule",
    memory: ProjectionMemory,
    sample: KernelSample,
    fit: Prospect,
    result: Estimated,
) -> ProjectionMemory:
    """Take in one frame by rule (21), and write Ĵ of the new â."""
    p1, points, o_c, shaft = sample.p1, sample.points, sample.o_c, sample.shaft
    memory = update(memory, p1, points, o_c, sample.dt, kernel, shaft)
    put(result.points, points)
    put(result.J_hat, jacobian_at(memory.a_hat, p1, points, o_c, shaft))
    if sample.needs_motion:
        put(result.motion, markers_jacobian(memory.a_hat, p1, shaft))
    result.placed = False
    return memory


@compiled
def empty_kernel(kernel: "Rule", memory: ProjectionMemory) -> ProjectionMemory:
    """Return the memory before the first frame."""
    return ProjectionMemory(np.zeros_like(memory.observations), 0, np.zeros_like(memory.a_hat))


class Rule(NamedTuple):
    """Settings of rule (21), the compiled form of the estimator.

    Parameters
    ----------
    rate : float
        η of the fast Γ, 1/s; 0 for the printed Γ.
    epsilon : float
        ε of the fast Γ, which the choice of observations needs with either Γ.
    both : bool
        Whether m₂ is fitted as well as m₁.
    time : float
        Time that every new frame gives it, s; 0 for the real time between frames.
    """

    rate: float
    epsilon: float
    both: bool
    time: float = 0.0

    places_rcm = False
    update = update_kernel
    empty = empty_kernel


@compiled
def predict(a: Floats, p1: Floats, shaft: Shaft) -> Floats:
    """π of eq. (34) for both markers: m (4,) px from the imaged RCM."""
    m = np.empty(4)
    put(m[:2], project(a, p1))
    put(m[2:], project(a, second_marker(shaft, p1)))
    return m


@dataclass(frozen=True)
class ProjectionEstimator(Estimator):
    """Ĵ through the projection parameters, rule (21).

    Parameters
    ----------
    gamma : Literal['fast', 'printed']
        Γ of rule (21): fast, or the paper's as printed.
    rate : float
        η of the fast Γ, 1/s.
    epsilon : float
        ε of the fast Γ: modes of MᵀM weaker than ε Γ₀⁻¹ learn more slowly.
    observations : int
        P, the number of observations kept.
    both_markers : bool
        Fit m₂ as well as the paper's m₁.
    estimator_time : float
        Time that the rule is given for every new frame, s; 0 stands for the real time between
        frames.
    """

    gamma: Literal["fast", "printed"] = "fast"
    rate: Annotated[float, positive("rate in 1/s")] = 20.0
    epsilon: Annotated[float, at_least(LEAST_EPSILON, "(less is lost in rounding)")] = 1e-7
    observations: Annotated[int, between(6, MOST, "a whole number (by Proposition 1)")] = 20
    both_markers: bool = True
    estimator_time: Annotated[float, not_negative("time in s")] = 0.0

    name = "projection"
    models = True

    def __post_init__(self) -> None:
        super().__post_init__()
        decays = self.gamma == "printed" or self.rate * self.estimator_time <= MAX_DECAY
        right = f"at most {MAX_DECAY:g} / rate with the fast Γ, whose modes decay long before"
        self.require(decays, "estimator_time", right)

    def init(self) -> ProjectionMemory:
        return ProjectionMemory(np.zeros((self.observations + 1, 7)), 0, np.zeros(PARAMETERS))

    @cached_property
    def kernel(self) -> Rule:
        """Its compiled form."""
        rate = float(self.rate) if self.gamma == "fast" else 0.0
        return Rule(rate, float(self.epsilon), bool(self.both_markers), float(self.estimator_time))

    def update(self, memory: ProjectionMemory, tool: Tool, sample: Sample) -> ProjectionMemory:
        p1, points, o_c, dt, _ = sample
        return update(memory, p1, points, o_c, dt, self.kernel, tool.shaft)

    def jacobian(self, memory: ProjectionMemory, tool: Tool, sample: Sample) -> Floats:
        return jacobian_at(memory.a_hat, sample.p1, sample.points, sample.o_c, tool.shaft)

    def motion(self, memory: ProjectionMemory, tool: Tool, sample: Sample) -> Floats:
        return markers_jacobian(memory.a_hat, sample.p1, tool.shaft)

    def predict(self, memory: ProjectionMemory, tool: Tool, p1: Floats) -> Floats:
        return predict(memory.a_hat, p1, tool.shaft)


PRINTED = ProjectionEstimator(
    gamma="printed", observations=10, both_markers=False, estimator_time=1e4
)
"""The paper's own: the printed Γ, P = 10 observations of m₁; each new frame gives it 10⁴ s, as in
real time it would need hours."""
