"""From the feature error to a velocity: the saturated potential (32) and the law (31), v = −k Ĵ⁻¹
∂V/∂y.

Features and Jacobian are scaled, diag(1/SCALE) Ĵ, so that a condition number means the same in
every scene. The inverse is damped in directions that Ĵ hardly tells: what is left of the error then
tells whether the way is open.
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
from rcmservo.geometry.features import SCALE
from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, length
from rcmservo.numerics.small_solvers import solve_3x3
from rcmservo.numerics.small_svd import extremes, put_right

SURE = 1e3
"""Condition of the scaled Ĵ up to which its inverse is taken as it is, where nothing is damped."""


@compiled
def potential_gradient(delta: Floats, bounds: Floats, printed: bool) -> Floats:
    """∂V/∂y (n,): Δy inside ±b and, beyond, ±b (continuous, Fig. 5) or ±b/2 (as (32) is
    printed).
    """
    gradient = np.empty(len(delta))
    saturate(delta, bounds, printed, gradient)
    return gradient


@compiled
def saturate(delta: Floats, bounds: Floats, printed: bool, gradient: Floats) -> None:
    """Write it over `gradient` (n,)."""
    beyond = 0.5 if printed else 1.0
    for i in range(len(delta)):
        inside = abs(delta[i]) < bounds[i]
        gradient[i] = delta[i] if inside else np.sign(delta[i]) * beyond * bounds[i]


@compiled
def potential(delta: Floats, bounds: Floats, printed: bool) -> float:
    """V = Σ Vᵢ of (32): ½Δy² inside ±b and, beyond, b|Δy| − ½b² (continuous) or ½b|Δy|
    (printed).
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
def scaled(J: Floats) -> Floats:
    """diag(1/SCALE) J: every norm and condition is judged on this."""
    out = np.empty(J.shape)
    scale(J, out)
    return out


@compiled
def scale(J: Floats, out: Floats) -> None:
    """Write diag(1/SCALE) J."""
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            out[i, j] = J[i, j] / SCALE[i]


@compiled
def largest_scaled(J: Floats) -> float:
    """Return the largest absolute value of diag(1/SCALE) J; NaN if a number is NaN."""
    most = 0.0
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            size = abs(J[i, j]) / SCALE[i]
            if np.isnan(size):
                return np.nan
            most = max(most, size)
    return most


class Heading(NamedTuple):
    """Where the law goes, and how well it can.

    Parameters
    ----------
    v : Point
        mm/s of marker 1.
    condition : float
        Of Ĵ, scaled.
    open : float
        Share of the error, scaled, that v works off: 1 where nothing is damped, 0 where no motion
        that Ĵ knows of makes it smaller.
    left : float
        mm that marker 1 is away from the target by what v works off, however slow v is.
    """

    v: Point
    condition: float
    open: float
    left: float


@compiled
def law(
    J: Floats, gradient: Floats, gain: float, max_condition: float, max_speed: float
) -> Heading:
    """The heading of eq. (31), by least squares where there are more than three features, all of
    them scaled: J (n, 3) in 1/mm and ∂V/∂y (n,).

    The whole velocity is scaled down where it exceeds max_speed, so that its direction stays.
    """
    if not (all_finite(J) and length(J) > 0.0):
        return Heading((0.0, 0.0, 0.0), np.inf, 0.0, np.inf)
    v, condition, way = (0.0, 0.0, 0.0), np.inf, 1.0
    if len(J) == 3:
        (x, y, z), condition = solve_3x3(J, gradient)
        v = -gain * x, -gain * y, -gain * z
    if not condition < min(0.5 * max_condition, SURE):
        v, condition, way = damped(J.copy(), gradient, gain, max_condition)
    speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    slower = max(1.0, speed / max_speed)
    v = v[0] / slower, v[1] / slower, v[2] / slower
    return Heading(v, condition, way, speed / gain)


@compiled
def damped(B: Floats, g: Floats, gain: float, max_condition: float) -> tuple[Point, float, float]:
    """Return v mm/s of the scaled gradient g (n,) and the scaled Ĵ, B (n, 3), which is turned in
    place; the condition of Ĵ, and the share of the error that v works off.

    v is built along the right-angled columns of B = Ĵ V, whose lengths σ are the
    singular values. Those below 2σ₁/max_condition are damped, so that |v| stops growing.
    """
    V, v, total, done = np.empty((3, 3)), np.zeros(3), 0.0, 0.0
    put_right(B, V)
    low, high = extremes(B)
    floor = 2.0 * high / max_condition
    for k in range(len(B)):
        total += g[k] ** 2
    for i in range(3):
        sigma, along = length(B[:, i]), 0.0
        for k in range(len(B)):
            along += B[k, i] * g[k]
        shortfall = max(1.0 - sigma / floor, 0.0)
        share = along / (sigma**2 + (shortfall * floor) ** 2)
        done += along * share
        for k in range(3):
            v[k] -= gain * V[k, i] * share
    condition = high / low if low > 0.0 and high < np.inf else np.inf
    return (v[0], v[1], v[2]), condition, done / total if total > 0.0 else 1.0


@compiled
def control(
    J: Floats,
    delta: Floats,
    bounds: Floats,
    printed: bool,
    gain: float,
    max_condition: float,
    max_speed: float,
) -> tuple[Heading, float]:
    """For the scaled error Δy (n,), bounds b (n,) and Jacobian (n, 3): the heading by (32) and
    (31), and √(2V).

    √(2V) is |Δy| where nothing is saturated. (33) makes V fall, while one component alone may rise
    on the way.
    """
    gradient = np.empty(len(delta))
    saturate(delta, bounds, printed, gradient)
    heading = law(J, gradient, gain, max_condition, max_speed)
    return heading, np.sqrt(2.0 * potential(delta, bounds, printed))


@dataclass(frozen=True)
class SaturatedController(Checked, section="controller"):
    """The law (31) with the saturated potential (32).

    Parameters
    ----------
    features : str
        Feature vector that it acts on; by least squares, where that has more than three components.
    gain : float
        k, 1/s. The greatest gain without overshoot is 1/(e T), where the drives follow T s after
        the joints were read: as built in T = 46 ms, of delay, lag and tick. The camera's latency
        does not count, as the error is carried on to the present joints, and noise neither, where
        the estimator averages it out; where it does not (all but dlt and affine), a smaller gain is
        quieter.
    bounds : Triple
        b, the feature errors (rad, px, px) from which on the action is saturated; the angle is at
        most π.
    potential : Literal['continuous', 'printed']
        V: continuous as Fig. 5 asks, or printed as (32) reads, where the action drops to half at b.
    max_speed : float
        Cap on the speed of both markers and of the tip, mm/s.
    tip : float
        How far the tip is beyond marker 2, mm.
    max_condition : float
        Condition number of the scaled Jacobian up to which its inverse is not damped by much: the
        damping begins at half of it.
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
        """Feature vector that it acts on."""
        return FEATURE_VECTORS[self.features]

    @cached_property
    def b(self) -> Floats:
        """The bounds (3,)."""
        return np.array(self.bounds)
