"""Control law v = −k Ĵ⁻¹ ∂V/∂y of (31) with the saturated potential V of (32).

Features and Jacobian are scaled to diag(1/SCALE) Ĵ, so that a condition number means the same in
every scene. The inverse is damped in directions that Ĵ hardly determines. The fraction of the error
that the damped motion reduces shows whether the target can be reached.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np

from rcmservo.constraints import (
    Checked,
    Triple,
    above,
    angles,
    between,
    one_of,
    positive,
    three_positive,
)
from rcmservo.control.feature_vectors import FEATURE_VECTORS, FeatureVector
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, compute_norm
from rcmservo.numerics.small_solvers import solve_3x3
from rcmservo.numerics.small_svd import find_column_length_range, orthogonalise_in_place

MAX_UNDAMPED_CONDITION = 1e3
"""Condition of the scaled Ĵ up to which its plain inverse is accurate enough without damping."""


@compiled
def potential_gradient(delta: Floats, bounds: Floats, printed: bool) -> Floats:
    """Return ∂V/∂y (n,) of (32): Δy inside ±b and, beyond, ±b (continuous) or ±b/2 (printed).

    Fig. 5 of the paper shows the continuous form, while (32) as printed drops to half at b.
    """
    gradient = np.empty(len(delta))
    write_gradient(delta, bounds, printed, gradient)
    return gradient


@compiled
def write_gradient(delta: Floats, bounds: Floats, printed: bool, gradient: Floats) -> None:
    """Write ∂V/∂y (n,) of (32)."""
    beyond = 0.5 if printed else 1.0
    for i in range(len(delta)):
        inside = abs(delta[i]) < bounds[i]
        gradient[i] = delta[i] if inside else np.sign(delta[i]) * beyond * bounds[i]


@compiled
def potential(delta: Floats, bounds: Floats, printed: bool) -> float:
    """Return V = Σ Vᵢ of (32).

    Vᵢ is ½Δy² inside ±b and, beyond, b|Δy| − ½b² (continuous) or ½b|Δy| (printed).
    """
    total = 0.0
    for i in range(len(delta)):
        size = abs(delta[i])
        if size < bounds[i]:
            total += 0.5 * size**2
        elif printed:
            total += 0.5 * bounds[i] * size
        else:
            total += bounds[i] * size - 0.5 * bounds[i] ** 2
    return total


@compiled
def scale_rows(J: Floats) -> Floats:
    """Return diag(1/SCALE) J, the matrix for every norm and condition."""
    out = np.empty(J.shape)
    write_scaled(J, out)
    return out


@compiled
def write_scaled(J: Floats, out: Floats) -> None:
    """Write diag(1/SCALE) J."""
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            out[i, j] = J[i, j] / FEATURE_SCALE[i]


@compiled
def max_scaled_entry(J: Floats) -> float:
    """Return the largest absolute value of diag(1/SCALE) J; NaN if a number is NaN."""
    largest = 0.0
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            size = abs(J[i, j]) / FEATURE_SCALE[i]
            if np.isnan(size):
                return np.nan
            largest = max(largest, size)
    return largest


class LawResult(NamedTuple):
    """Velocity of the control law and its quality.

    Parameters
    ----------
    v : Point
        Velocity (3,) of marker 1 in mm/s.
    condition : float
        Condition of the scaled Ĵ.
    reducible_fraction : float
        Fraction of the scaled error that v reduces: 1 without damping, 0 if no motion that Ĵ models
        reduces it.
    distance_to_target : float
        Distance (mm) of marker 1 to the target along v, independent of the speed.
    """

    v: Point
    condition: float
    reducible_fraction: float
    distance_to_target: float


@compiled
def solve_law(
    J: Floats, gradient: Floats, gain: float, max_condition: float, max_speed: float
) -> LawResult:
    """Return the velocity of eq. (31) and its quality.

    More than three features are solved by least squares. J (n, 3) per mm and the gradient ∂V/∂y
    (n,) are scaled. The whole velocity is reduced to max_speed, so that its direction stays.
    """
    if not (all_finite(J) and compute_norm(J) > 0.0):
        return LawResult((0.0, 0.0, 0.0), np.inf, 0.0, np.inf)
    v, condition, reducible = (0.0, 0.0, 0.0), np.inf, 1.0
    if len(J) == 3:
        (x, y, z), condition = solve_3x3(J, gradient)
        v = -gain * x, -gain * y, -gain * z
    if not condition < min(0.5 * max_condition, MAX_UNDAMPED_CONDITION):
        v, condition, reducible = damped_velocity(J.copy(), gradient, gain, max_condition)
    speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    slowdown = max(1.0, speed / max_speed)
    v = v[0] / slowdown, v[1] / slowdown, v[2] / slowdown
    return LawResult(v, condition, reducible, speed / gain)


@compiled
def damped_velocity(
    B: Floats, g: Floats, gain: float, max_condition: float
) -> tuple[Point, float, float]:
    """Return the damped v mm/s, the condition of Ĵ, and the fraction of the error that v reduces.

    B (n, 3) is the scaled Ĵ, which is rotated in place, and g (n,) the scaled gradient. v is a sum
    over the orthogonal columns of B = Ĵ V, whose lengths σ are the singular values. Those below
    2σ₁/max_condition are damped, so that |v| stays bounded.
    """
    V, v, total, reduced = np.empty((3, 3)), np.zeros(3), 0.0, 0.0
    orthogonalise_in_place(B, V)
    low, high = find_column_length_range(B)
    floor = 2.0 * high / max_condition
    for k in range(len(B)):
        total += g[k] ** 2
    for i in range(3):
        sigma, projection = compute_norm(B[:, i]), 0.0
        for k in range(len(B)):
            projection += B[k, i] * g[k]
        shortfall = max(1.0 - sigma / floor, 0.0)
        amplitude = projection / (sigma**2 + (shortfall * floor) ** 2)
        reduced += projection * amplitude
        for k in range(3):
            v[k] -= gain * V[k, i] * amplitude
    condition = high / low if low > 0.0 and high < np.inf else np.inf
    return (v[0], v[1], v[2]), condition, reduced / total if total > 0.0 else 1.0


@compiled
def apply_law(
    J: Floats,
    delta: Floats,
    bounds: Floats,
    printed: bool,
    gain: float,
    max_condition: float,
    max_speed: float,
) -> tuple[LawResult, float]:
    """Return the velocity by (32) and (31) with its quality, and √(2V).

    The error Δy (n,), the bounds b (n,) and the Jacobian (n, 3) are scaled. √(2V) is |Δy| without
    saturation. By (33) V decreases, while a single component may grow on the path.
    """
    gradient = np.empty(len(delta))
    write_gradient(delta, bounds, printed, gradient)
    heading = solve_law(J, gradient, gain, max_condition, max_speed)
    return heading, np.sqrt(2.0 * potential(delta, bounds, printed))


@dataclass(frozen=True)
class SaturatedController(Checked, section="controller"):
    """Saturated kinematic controller: control law (31) with the potential (32).

    The velocity of marker 1 is v = −k Ĵ⁻¹ ∂V/∂y. V is quadratic for small errors and linear beyond
    `bounds`. The inverse is damped where Ĵ is nearly singular.

    Parameters
    ----------
    features : str
        Feature vector that the controller acts on; by least squares if it has more than three
        components.
    gain : float
        Gain k, 1/s. Above 1/(e T) the tool overshoots, where T is the time in s from reading the
        joints to the motion of the drives: 46 ms by default, of delay, lag and tick. The camera's
        latency does not count, as the error is predicted for the present joints. Noise does not
        count if the estimator averages it; with the other estimators (all but dlt and affine) a
        smaller gain reduces the noise of the motion.
    bounds : Triple
        Saturation bounds b of the feature errors (rad, px, px); the angle is at most π.
    potential : Literal['continuous', 'printed']
        Potential V: continuous as in Fig. 5 of the paper, or printed as in (32), where the action
        drops to half at b.
    max_speed : float
        Speed limit of both markers and of the tip, mm/s.
    tip : float
        Distance from marker 2 to the tip, mm.
    max_condition : float
        Condition of the scaled Jacobian above which its inverse is strongly damped. Damping begins
        at half of it.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    Stability, eq. (33), assumes that Ĵ is accurate. With a feature vector of more than three
    components a part of the error may remain at the target.

    References
    ----------
    Section III-D of the paper; Y. Nakamura and H. Hanafusa, Inverse kinematic solutions with
    singularity robustness for robot manipulator control, J. Dynamic Systems, Measurement, and
    Control 108 (1986) 163-171, for the damping.
    """

    name = "saturated"

    features: Annotated[str, one_of(FEATURE_VECTORS)] = "srd"
    gain: Annotated[float, positive("gain in 1/s")] = 8.0
    bounds: Annotated[Triple, three_positive("rad, px, px"), angles(np.pi, first=1)] = (
        float(np.radians(50.0)),
        50.0,
        50.0,
    )
    potential: Literal["continuous", "printed"] = "continuous"
    max_speed: Annotated[float, positive("speed in mm/s")] = 40.0
    tip: Annotated[float, between(0.0, 1000.0, "a length", "mm")] = 0.0
    max_condition: Annotated[float, above(1.0)] = 150.0

    @property
    def feature_vector(self) -> FeatureVector:
        """Feature vector that the controller acts on."""
        return FEATURE_VECTORS[self.features]

    @cached_property
    def bounds_array(self) -> Floats:
        """Bounds b (3,) in (rad, px, px)."""
        return np.array(self.bounds)
