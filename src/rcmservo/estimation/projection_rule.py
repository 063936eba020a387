"""Projection-based estimation, eq. (17)-(25): fit nine parameters â to P observations, Ĵ from â.

An observation is the position p₁ and the raw pixels of both markers in one frame. The matrix M and
the vector m stack the rows W and the pixels of eq. (18) for all observations. Rule (21) is then the
linear differential equation

    dâ/dt = −Γ (MᵀM â − Mᵀm)

which is stable for any constant symmetric positive definite Γ (Proposition 1) and is integrated
exactly over any time (gradient_flow.py). Γ has two choices: the paper's Γ₀ = diag(1e-5 I₆, 1e-8
I₃), whose slowest mode needs hours, and Γ = η (MᵀM + ε Γ₀⁻¹)⁻¹, for which every well-observed mode
decays at the rate η.

The observations are chosen for excitation: of P + 1 the one with the least leverage on â is
removed, so that the extremes of the path stay. It is removed after the step, so that Γ, M and the
choice share one factorisation. Raw pixels are stored, so that all observations follow a change of
the imaged RCM.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np

from rcmservo.constraints import at_least, between, not_negative, positive
from rcmservo.estimation.base import Estimator, EstimatorResult, KernelSample, Sample
from rcmservo.estimation.camera_fit import ProjectionFit
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm
from rcmservo.geometry.projection import (
    PARAMETER_COUNT,
    compute_depth,
    compute_projection_jacobian,
    project,
)
from rcmservo.geometry.tool import (
    Tool,
    ToolStruct,
    compute_marker_ratio,
    compute_second_marker,
    compute_second_marker_jacobian,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.gradient_flow import integrate_gradient_flow
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into, multiply_matrices

GAMMA_0 = np.array([1e-5] * 6 + [1e-8] * 3)
"""Diagonal of the paper's Γ, for p in mm and m in px."""

MAX_DECAY = 1e5
"""Largest η t of the fast Γ. Far beyond it, rounding lets unobserved modes grow."""

MAX_OBSERVATIONS = 1000
"""Largest number of observations; each costs time at every new frame."""

MIN_EPSILON = 1e-10
"""Smallest ε with which MᵀM + ε Γ₀⁻¹ still has a Cholesky factor."""

MIN_DEPTH = 0.1
"""Smallest relative depth ẑ that an estimate may give to an observation.

Behind the camera the projection changes its sign.
"""


@dataclass(frozen=True)
class ProjectionEstimator(Estimator):
    """Estimator of Ĵ by the projection parameters of rule (21).

    The nine parameters â of the projection m = G p / (gᵀp + 1), the rows of G (2, 3) px/mm and g
    (3,) 1/mm, are fitted to P observations of p (3,) mm and m (2,) px from the imaged RCM. An
    observation m = (u, v) of p has the two rows of Wᵢ (2, 9), eq. (19),

        [pᵀ 0 −u pᵀ],    [0 pᵀ −v pᵀ]

    for which Wᵢ a = mᵢ. Its error is eᵢ = Wᵢ â − mᵢ, eq. (17). Rule (21) descends the gradient of
    Q = ½ Σ eᵢᵀeᵢ, eq. (20):

        dâ/dt = −Γ ∂Q/∂â = −Γ Σ Wᵢᵀ (Wᵢ â − mᵢ)

    It is integrated exactly, over all stored observations. These are the most informative ones, not
    the newest: each new frame is added to the P stored ones, and after the step the one with the
    least leverage on â is removed,

        tr(W (MᵀM + ε Γ₀⁻¹)⁻¹ Wᵀ),    MᵀM = Σ WᵢᵀWᵢ over all P + 1

    with W (2, 9) the rows of the observation, or (4, 9) those of both its markers. Ĵ (3, 3) in
    rad/mm, px/mm, px/mm is ∂y/∂m ∂m/∂p₁, eq. (15), with ∂m/∂p₁ (4, 3) px/mm of the projection.

    Parameters
    ----------
    gamma : Literal['fast', 'printed']
        Γ of rule (21): 'fast' is η (MᵀM + ε Γ₀⁻¹)⁻¹ with MᵀM = Σ WᵢᵀWᵢ, 'printed' is the paper's
        Γ₀ = diag(1e-5 I₆, 1e-8 I₃).
    rate : float
        Decay rate η of the fast Γ, 1/s, positive.
    epsilon : float
        Regularisation ε of the fast Γ, at least 1e-10: modes of MᵀM weaker than ε Γ₀⁻¹ converge
        more slowly.
    observations : int
        P, the number of stored observations, from 6 (Proposition 1) to 1000.
    both_markers : bool
        Fit marker 2 in addition to the paper's marker 1.
    estimator_time : float
        Time over which every new frame integrates the rule, s, not negative. 0 stands for the real
        time between frames.

    Raises
    ------
    BadInput
        If a parameter is outside its range, or `estimator_time` is above 1e5 / `rate` with the fast
        Γ.

    Notes
    -----
    The model needs the RCM in front of the camera, eq. (10), and the imaged RCM of eq. (16). With
    the paper's Γ it converges in hours.

    Both choices of Γ select the observations by the same leverage, which ε regularises. The raw
    pixels are stored, so that m of all observations follows a change of the imaged RCM. A step
    ends before the relative depth gᵀp + 1 of an observation falls below 0.1.

    References
    ----------
    Section III-B of the paper, Proposition 1.
    """

    gamma: Literal["fast", "printed"] = "fast"
    rate: Annotated[float, positive("rate in 1/s")] = 20.0
    epsilon: Annotated[float, at_least(MIN_EPSILON, "(a smaller value is lost in rounding)")] = 1e-7
    observations: Annotated[
        int, between(6, MAX_OBSERVATIONS, "a whole number (Proposition 1 needs 6)")
    ] = 20
    both_markers: bool = True
    estimator_time: Annotated[float, not_negative("time in s")] = 0.0

    name = "projection"
    predicts_markers = True

    def __post_init__(self) -> None:
        super().__post_init__()
        is_stable = self.gamma == "printed" or self.rate * self.estimator_time <= MAX_DECAY
        expected = f"at most {MAX_DECAY:g} / rate with the fast Γ, whose modes have then decayed"
        self.require(is_stable, "estimator_time", expected)

    def init(self) -> "ProjectionMemory":
        """Return the memory before the first frame: no observation, and â = 0."""
        return ProjectionMemory(np.zeros((self.observations + 1, 7)), 0, np.zeros(PARAMETER_COUNT))

    @cached_property
    def kernel(self) -> "ProjectionKernel":
        """Compiled form of the estimator."""
        rate = float(self.rate) if self.gamma == "fast" else 0.0
        epsilon, estimator_time = float(self.epsilon), float(self.estimator_time)
        return ProjectionKernel(rate, epsilon, bool(self.both_markers), estimator_time)

    def update(self, memory: "ProjectionMemory", tool: Tool, sample: Sample) -> "ProjectionMemory":
        """Return the memory after a step of rule (21) with the observation of one new frame."""
        p1, points, o_c, dt, _ = sample
        return update_from_frame(memory, p1, points, o_c, dt, self.kernel, tool.struct)

    def jacobian(self, memory: "ProjectionMemory", tool: Tool, sample: Sample) -> Floats:
        """Return Ĵ (3, 3) of eq. (15), ∂y/∂m at the measured markers times ∂m/∂p₁ by â."""
        return compute_jacobian_at_points(
            memory.a_hat, sample.p1, sample.points, sample.o_c, tool.struct
        )

    def markers_jacobian(self, memory: "ProjectionMemory", tool: Tool, sample: Sample) -> Floats:
        """Return ∂m/∂p₁ (4, 3) in px/mm of both markers by the projection with â."""
        return compute_markers_jacobian(memory.a_hat, sample.p1, tool.struct)

    def predict(self, memory: "ProjectionMemory", tool: Tool, p1: Floats) -> Floats:
        """Return the markers m (4,) in px from o_c that â predicts for p₁ (3,) mm; never None."""
        return predict_markers(memory.a_hat, p1, tool.struct)


PAPER_PROJECTION_ESTIMATOR = ProjectionEstimator(
    gamma="printed", observations=10, both_markers=False, estimator_time=1e4
)
"""The paper's estimator: its Γ, and P = 10 observations of marker 1.

Each new frame integrates the rule over 10⁴ s, as it would need hours in real time.
"""


class ProjectionMemory(NamedTuple):
    """Observations and the parameters that are fitted to them.

    Parameters
    ----------
    observations : Floats
        Rows (P + 1, 7) of p₁ (3) mm and the raw pixels of both markers (4); the last row is spare.
    observation_count : int
        Number of rows in use, from the first on.
    a_hat : Floats
        â (9,); zeros at first.
    """

    observations: Floats
    observation_count: int
    a_hat: Floats


@compiled
def collect_fitted_points(
    observations: Floats, count: int, o_c: Floats, both: bool, shaft: ToolStruct
) -> Floats:
    """Return the fitted points (n, 5) as rows of p mm (3) and its pixels from o_c (2).

    Marker 1 of all observations comes first, then marker 2 if ``both`` are fitted.
    """
    rows = np.empty((2 * count if both else count, 5))
    for i in range(count):
        observation = observations[i]
        factor = compute_marker_ratio(shaft, observation[:3])
        for k in range(3):
            rows[i, k] = observation[k]
            if both:
                rows[count + i, k] = factor * observation[k]
        for k in range(2):
            rows[i, 3 + k] = observation[3 + k] - o_c[k]
            if both:
                rows[count + i, 3 + k] = observation[5 + k] - o_c[k]
    return rows


@compiled
def build_normal_equations(points: Floats) -> tuple[Floats, Floats]:
    """Return MᵀM (9, 9) and Mᵀm (9,) of eq. (23)-(24).

    The blocks of MᵀM are sums of p pᵀ over the points, those of Mᵀm sums of p, each with the weight
    1, u, v or u² + v². They stand where eq. (19) has the entries of W.
    """
    second_moments, first_moments = np.zeros((4, 3, 3)), np.zeros((4, 3))
    for row in range(len(points)):
        u, v = points[row, 3], points[row, 4]
        weights = (1.0, u, v, u * u + v * v)
        for i in range(3):
            for k in range(4):
                first_moments[k, i] += weights[k] * points[row, i]
            for j in range(3):
                product = points[row, i] * points[row, j]
                for k in range(4):
                    second_moments[k, i, j] += weights[k] * product
    A, b = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT)), np.empty(PARAMETER_COUNT)
    for i in range(3):
        b[i], b[3 + i] = first_moments[1, i], first_moments[2, i]
        b[6 + i] = -first_moments[3, i]
        for j in range(3):
            A[i, j] = A[3 + i, 3 + j] = second_moments[0, i, j]
            A[i, 6 + j] = A[6 + i, j] = -second_moments[1, i, j]
            A[3 + i, 6 + j] = A[6 + i, 3 + j] = -second_moments[2, i, j]
            A[6 + i, 6 + j] = second_moments[3, i, j]
    return A, b


@compiled
def compute_leverage(inverse: Floats, diagonal_sum: Floats, point: Floats) -> float:
    """Return tr(W A⁻¹ Wᵀ) of one point [p m] (5,), with the `inverse` A⁻¹ (9, 9) in blocks.

    `diagonal_sum` (3, 3) is the sum of the first two diagonal blocks.
    """
    u, v = point[3], point[4]
    squared_radius, total = u * u + v * v, 0.0
    for i in range(3):
        for j in range(3):
            diagonal = diagonal_sum[i, j] + squared_radius * inverse[6 + i, 6 + j]
            off_diagonal = u * inverse[i, 6 + j] + v * inverse[3 + i, 6 + j]
            total += point[i] * point[j] * (diagonal - 2.0 * off_diagonal)
    return total


@compiled
def find_least_informative_observation(points: Floats, count: int, root: Floats) -> int:
    """Return the index of the observation with the least leverage tr(W root rootᵀ Wᵀ) on â.

    `points` are the rows of the `count` observations, and root rootᵀ is (MᵀM + εΓ₀⁻¹)⁻¹.
    """
    inverse = multiply_matrices(root, root.T)
    diagonal_sum = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            diagonal_sum[i, j] = inverse[i, j] + inverse[3 + i, 3 + j]
    leverages = np.zeros(count)
    for row in range(len(points)):
        leverages[row % count] += compute_leverage(inverse, diagonal_sum, points[row])
    index = 0
    for i in range(count):
        if leverages[i] < leverages[index]:
            index = i
    return index


@compiled
def compute_inverse_root(A: Floats, epsilon: float) -> Floats:
    """Return L⁻ᵀ (9, 9) with L Lᵀ = A + ε Γ₀⁻¹, by forward substitution.

    Its product with its transpose is (A + ε Γ₀⁻¹)⁻¹. The integration of rule (21) needs such a root
    of Γ and not only Γ.
    """
    regularised = A.copy()
    for i in range(PARAMETER_COUNT):
        regularised[i, i] += epsilon / GAMMA_0[i]
    L = np.linalg.cholesky(regularised)
    root = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT))
    for column in range(PARAMETER_COUNT):
        root[column, column] = 1.0 / L[column, column]
        for i in range(column + 1, PARAMETER_COUNT):
            total = 0.0
            for j in range(column, i):
                total -= L[i, j] * root[column, j]
            root[column, i] = total / L[i, i]
    return root


@compiled
def limit_step_by_depth(
    a: Floats, a_next: Floats, observations: Floats, count: int, shaft: ToolStruct
) -> Floats:
    """Return a_next (9,), or the last point on the line from a with every depth ẑ ≥ MIN_DEPTH.

    ẑ is linear in â, and the function U of eq. (22) is convex, so that U also decreases on the
    shortened step.
    """
    fraction = 1.0
    for i in range(count):
        p1 = observations[i, :3]
        z, z_next = compute_depth(a, p1), compute_depth(a_next, p1)
        for factor in (1.0, compute_marker_ratio(shaft, p1)):
            before, after = 1.0 + factor * (z - 1.0), 1.0 + factor * (z_next - 1.0)
            if after < MIN_DEPTH:
                fraction = min(fraction, max((before - MIN_DEPTH) / (before - after), 0.0))
    limited = np.empty(len(a))
    for k in range(len(a)):
        limited[k] = a[k] + fraction * (a_next[k] - a[k])
    return limited


@compiled
def compute_gamma_root(root: Floats, rate: float) -> Floats:
    """Return C (9, 9) with Γ = C Cᵀ: the fast Γ with η = `rate`, or the paper's Γ₀ if `rate` is 0.

    `root` (9, 9) is a root of (MᵀM + ε Γ₀⁻¹)⁻¹.
    """
    C = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT))
    for i in range(PARAMETER_COUNT):
        C[i, i] = np.sqrt(GAMMA_0[i])
        for j in range(PARAMETER_COUNT):
            if rate > 0.0:
                C[i, j] = np.sqrt(rate) * root[i, j]
    return C


@compiled
def update_from_frame(
    memory: ProjectionMemory,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    dt: float,
    kernel: "ProjectionKernel",
    shaft: ToolStruct,
) -> ProjectionMemory:
    """Return the memory after a step of rule (21) with one observation, dt s after the previous."""
    duration = kernel.estimator_time if kernel.estimator_time > 0.0 else dt
    if kernel.rate > 0.0:
        duration = min(duration, MAX_DECAY / kernel.rate)
    observations, a, count = memory.observations.copy(), memory.a_hat, memory.observation_count + 1
    newest = observations[count - 1]
    copy_into(newest[:3], p1)
    copy_into(newest[3:], points.copy().reshape(4))
    fitted = collect_fitted_points(observations, count, o_c, kernel.both_markers, shaft)
    A, b = build_normal_equations(fitted)
    root = compute_inverse_root(A, kernel.epsilon)
    C = compute_gamma_root(root, kernel.rate)
    a_next = integrate_gradient_flow(A, b, a, C, duration)
    a_next = limit_step_by_depth(a, a_next, observations, count, shaft)
    if count == len(observations):
        row = find_least_informative_observation(fitted, count, root)
        count -= 1
        copy_into(observations[row], observations[count])
    return ProjectionMemory(observations, count, a_next)


@compiled
def compute_markers_jacobian(a: Floats, p1: Floats, shaft: ToolStruct) -> Floats:
    """Return ∂m/∂p₁ (4, 3) px/mm of both markers, the second factor of eq. (15)."""
    p2, jacobian = compute_second_marker(shaft, p1), np.empty((4, 3))
    copy_into(jacobian[:2], compute_projection_jacobian(a, p1))
    dm2_dp2 = compute_projection_jacobian(a, p2)
    copy_into(jacobian[2:], multiply_matrices(dm2_dp2, compute_second_marker_jacobian(shaft, p1)))
    return jacobian


@compiled
def compute_estimated_jacobian(a: Floats, p1: Floats, m: Floats, shaft: ToolStruct) -> Floats:
    """Return Ĵ (3, 3) of eq. (15): ∂y/∂m at the measured m, times ∂m/∂p₁ by the parameters a."""
    return multiply_matrices(compute_features_jacobian(m), compute_markers_jacobian(a, p1, shaft))


@compiled
def compute_jacobian_at_points(
    a: Floats, p1: Floats, points: Floats, o_c: Floats, shaft: ToolStruct
) -> Floats:
    """Return Ĵ (3, 3) of eq. (15) at the raw `points` (2, 2) px by the parameters a."""
    return compute_estimated_jacobian(a, p1, shift_to_rcm(points, o_c), shaft)


@compiled
def update_kernel(
    kernel: "ProjectionKernel",
    memory: ProjectionMemory,
    sample: KernelSample,
    fit: ProjectionFit,
    result: EstimatorResult,
) -> ProjectionMemory:
    """Update the memory by one frame with rule (21), and write Ĵ of the new â."""
    p1, points, o_c, shaft = sample.p1, sample.points, sample.o_c, sample.shaft
    memory = update_from_frame(memory, p1, points, o_c, sample.dt, kernel, shaft)
    copy_into(result.points, points)
    copy_into(result.J_hat, compute_jacobian_at_points(memory.a_hat, p1, points, o_c, shaft))
    if sample.needs_markers_jacobian:
        copy_into(result.markers_jacobian, compute_markers_jacobian(memory.a_hat, p1, shaft))
    result.has_imaged_rcm = False
    return memory


@compiled
def make_initial_memory(kernel: "ProjectionKernel", memory: ProjectionMemory) -> ProjectionMemory:
    """Return the memory before the first frame."""
    return ProjectionMemory(np.zeros_like(memory.observations), 0, np.zeros_like(memory.a_hat))


class ProjectionKernel(NamedTuple):
    """Settings of rule (21), the compiled form of the estimator.

    Parameters
    ----------
    rate : float
        η of the fast Γ in 1/s; 0 for the paper's Γ.
    epsilon : float
        ε of the fast Γ, which the choice of observations needs with either Γ.
    both_markers : bool
        True to fit marker 2 in addition to marker 1.
    estimator_time : float
        Integration time of every new frame in s; 0 for the real time between frames.
    """

    rate: float
    epsilon: float
    both_markers: bool
    estimator_time: float = 0.0

    estimates_rcm = False
    update = update_kernel
    reset = make_initial_memory


@compiled
def predict_markers(a: Floats, p1: Floats, shaft: ToolStruct) -> Floats:
    """Return π of eq. (34) for both markers: m (4,) px from the imaged RCM."""
    m = np.empty(4)
    copy_into(m[:2], project(a, p1))
    copy_into(m[2:], project(a, compute_second_marker(shaft, p1)))
    return m
