"""Controller v = −k Ĵ⁻¹ ∂V/∂y, eq. (31), with the saturated potential V of eq. (32).

The rows of Ĵ and the features are divided by their units FEATURE_SCALE, so that a condition number
means the same in every scene. The inverse is damped in directions that Ĵ hardly determines. The
fraction of the error that the damped motion reduces shows if the target can be reached.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np

from rcmservo.constraints import (
    Checked,
    Limit,
    Triple,
    above,
    angles,
    between,
    not_negative,
    one_of,
    positive,
    three_positive,
)
from rcmservo.control.feature_vectors import FEATURE_VECTORS
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, compute_norm
from rcmservo.numerics.small_solvers import solve_3x3
from rcmservo.numerics.small_svd import find_column_length_range, orthogonalise_in_place

DEFAULT_BOUNDS = float(np.radians(50.0)), 50.0, 50.0
"""Saturation bounds b by default, in rad, px, px."""

APPROACH_LIMIT = Limit(
    lambda offset: bool((np.abs(offset) <= [0.1, 0.1, 10.0]).all()),
    "three offsets (rad, rad, mm) of at most 0.1 rad, 0.1 rad and 10 mm",
)

MAX_UNDAMPED_CONDITION = 1e3
"""Condition of the scaled Ĵ up to which its inverse is accurate enough without damping."""


@dataclass(frozen=True)
class SaturatedController(Checked, section="controller"):
    """Saturated kinematic controller, eq. (31) with the potential of eq. (32).

    The velocity v (3,) mm/s of marker 1 follows from the estimated Jacobian Ĵ (3, 3) and the error
    Δy = y − y_d (3,) of the features in rad, px, px, eq. (31):

        v = −k Ĵ⁻¹ ∂V/∂y

    The potential V = Σ Vᵢ, eq. (32), is quadratic for small errors and linear beyond the bounds bᵢ:

        Vᵢ = ½ Δyᵢ²             if |Δyᵢ| < bᵢ
        Vᵢ = bᵢ |Δyᵢ| − ½ bᵢ²   otherwise

    The inverse is damped where Ĵ is nearly singular, and v is slowed to the speed limit. An
    instance is passed as the argument `controller` of `Servo`.

    Parameters
    ----------
    features : str
        Feature vector that the controller acts on: 'srd', 'points', 'size', or the name of one that
        `add_feature_vector` has registered. More than three components act by least squares.
    gain : float
        Gain k, 1/s, positive. The tool would overshoot for a time T above 1/(e k), with e = 2.718,
        from reading the joints to the motion of the drives: delay, lag and tick, 34 ms of the
        simulated arm by default. 1/(e k) is 46 ms for the default gain. Beyond it the error is
        predicted for the joints that the measured lag leads to. The camera's latency does not
        count, as the error is predicted for the present joints. Noise does not count if the
        estimator averages it; with the other estimators (all but dlt and affine) a smaller gain
        reduces the noise of the motion.
    bounds : Triple
        Saturation bounds b of the feature errors (rad, px, px), positive; that of the angle is at
        most π. By default they are 50° (0.873 rad), 50 px and 50 px.
    potential : Literal['continuous', 'printed']
        Potential V beyond the bounds: 'continuous' as above and in Fig. 5 of the paper, or
        'printed', ½ bᵢ |Δyᵢ| as in the paper's eq. (32), with which ∂V/∂y drops to half at b.
    max_speed : float
        Speed limit of both markers and of the tip while exploring and servoing, mm/s, positive.
    tip : float
        Distance from marker 2 to the tip, mm, from 0 to 1000.
    joint_trust : float
        Trust in the joints of teaching as a measurement of the target, 1/mm, not negative: the
        reciprocal of their standard deviation. They decide in a direction that the image hardly
        shows. With 0 the image alone decides, as in the paper.
    approach : Triple
        Offset of the joints from those of teaching (rad, rad, mm) at the pose through which the
        tool goes to the target, at most 0.1 rad and 10 mm. Each joint then arrives from the side of
        its offset, with its backlash taken up, if the offset is larger than the backlash. By
        default 0: the tool goes there directly. A target without joints is approached directly.
    max_condition : float
        Condition number of the Jacobian, with its rows in units of 10° and 10 px, above 1, beyond
        which its inverse is strongly damped. Damping begins at half of it.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    The feature vectors are 'srd', the paper's y = [s r d] of eq. (7)-(9), for every estimator;
    'points', the coordinates (u₁, v₁, u₂, v₂) of both markers, for one that estimates their motion
    (projection, dlt, affine); and 'size', these and both apparent radii (R₁, R₂), for one that also
    estimates their change (affine), and a target with radii.

    Error, ∂V/∂y and the rows of Ĵ are divided by 10° for an angle and by 10 px otherwise. With the
    singular values σ₁ >= σ₂ >= σ₃ of this scaled Ĵ, and its singular vectors uᵢ (n,) and wᵢ (3,),
    the damped velocity is

        v = −k Σ wᵢ σᵢ uᵢᵀ(∂V/∂y) / (σᵢ² + λᵢ²),    λᵢ = max(2 σ₁/max_condition − σᵢ, 0)

    At the condition σ₁/σ₃ = max_condition, damping halves the part of σ₃; v stays bounded beyond.

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
        DEFAULT_BOUNDS
    )
    potential: Literal["continuous", "printed"] = "continuous"
    max_speed: Annotated[float, positive("speed in mm/s")] = 40.0
    tip: Annotated[float, between(0.0, 1000.0, "a length", "mm")] = 0.0
    joint_trust: Annotated[float, not_negative("number per mm")] = 1.0
    approach: Annotated[Triple, APPROACH_LIMIT] = (0.0, 0.0, 0.0)
    max_condition: Annotated[float, above(1.0)] = 150.0

    @cached_property
    def bounds_array(self) -> Floats:
        """Bounds b (3,) in (rad, px, px)."""
        return np.array(self.bounds)


@compiled
def compute_potential_gradient(delta: Floats, bounds: Floats, follows_paper: bool) -> Floats:
    """Return ∂V/∂y (n,) of (32): Δy inside ±b and, beyond, ±b or, if `follows_paper`, ±b/2.

    Fig. 5 of the paper shows the continuous form, while its eq. (32) drops to half at b.
    """
    gradient, saturated_fraction = np.empty(len(delta)), 0.5 if follows_paper else 1.0
    for i in range(len(delta)):
        is_inside = abs(delta[i]) < bounds[i]
        saturated = np.sign(delta[i]) * saturated_fraction * bounds[i]
        gradient[i] = delta[i] if is_inside else saturated
    return gradient


@compiled
def compute_potential(delta: Floats, bounds: Floats, follows_paper: bool) -> float:
    """Return V = Σ Vᵢ of (32).

    Vᵢ is ½Δy² inside ±b and, beyond, b|Δy| − ½b² or, if `follows_paper`, ½b|Δy|.
    """
    total = 0.0
    for i in range(len(delta)):
        size = abs(delta[i])
        if size < bounds[i]:
            total += 0.5 * size**2
        elif follows_paper:
            total += 0.5 * bounds[i] * size
        else:
            total += bounds[i] * size - 0.5 * bounds[i] ** 2
    return total


@compiled
def scale_rows(J: Floats) -> Floats:
    """Return J (3, 3) with each row divided by FEATURE_SCALE, for norms and condition numbers."""
    scaled = np.empty(J.shape)
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            scaled[i, j] = J[i, j] / FEATURE_SCALE[i]
    return scaled


@compiled
def find_max_scaled_entry(J: Floats) -> float:
    """Return the largest absolute entry of J with scaled rows; NaN if an entry is NaN."""
    largest = 0.0
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            size = abs(J[i, j]) / FEATURE_SCALE[i]
            if np.isnan(size):
                return np.nan
            largest = max(largest, size)
    return largest


class ControllerOutput(NamedTuple):
    """Velocity that the controller requests, and its quality.

    Parameters
    ----------
    v : Point
        Velocity of marker 1 in mm/s.
    condition : float
        Condition number of the scaled Ĵ.
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
def solve_velocity(
    J: Floats, gradient: Floats, gain: float, max_condition: float, max_speed: float
) -> ControllerOutput:
    """Return the velocity v = −gain J⁻¹ gradient of eq. (31) and its quality.

    J (n, 3) per mm and the gradient ∂V/∂y (n,) are scaled. For more than three features v is the
    least-squares solution. A faster v is slowed to `max_speed` mm/s without changing its direction.
    """
    if not (all_finite(J) and compute_norm(J) > 0.0):
        return ControllerOutput((0.0, 0.0, 0.0), np.inf, 0.0, np.inf)
    v, condition, reducible_fraction = (0.0, 0.0, 0.0), np.inf, 1.0
    if len(J) == 3:
        (x, y, z), condition = solve_3x3(J, gradient)
        v = -gain * x, -gain * y, -gain * z
    if not condition < min(0.5 * max_condition, MAX_UNDAMPED_CONDITION):
        v, condition, reducible_fraction = compute_damped_velocity(
            J.copy(), gradient, gain, max_condition
        )
    speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    slowdown = max(1.0, speed / max_speed)
    v = v[0] / slowdown, v[1] / slowdown, v[2] / slowdown
    return ControllerOutput(v, condition, reducible_fraction, speed / gain)


@compiled
def compute_damped_velocity(
    B: Floats, gradient: Floats, gain: float, max_condition: float
) -> tuple[Point, float, float]:
    """Return the damped v mm/s, the condition of Ĵ, and the fraction of the error that v reduces.

    B (n, 3) is the scaled Ĵ and `gradient` (n,) the scaled ∂V/∂y. A rotation V, in place, makes the
    columns of B = Ĵ V orthogonal; their lengths σ are the singular values of Ĵ. v is a sum over
    these columns. Those with σ below 2σ₁/max_condition are damped, so that |v| stays bounded.
    """
    V, v, squared_gradient, reduced = np.empty((3, 3)), np.zeros(3), 0.0, 0.0
    orthogonalise_in_place(B, V)
    sigma_min, sigma_max = find_column_length_range(B)
    damped_below = 2.0 * sigma_max / max_condition
    for k in range(len(B)):
        squared_gradient += gradient[k] ** 2
    for i in range(3):
        sigma, projection = compute_norm(B[:, i]), 0.0
        for k in range(len(B)):
            projection += B[k, i] * gradient[k]
        shortfall = max(1.0 - sigma / damped_below, 0.0)
        amplitude = projection / (sigma**2 + (shortfall * damped_below) ** 2)
        reduced += projection * amplitude
        for k in range(3):
            v[k] -= gain * V[k, i] * amplitude
    condition = sigma_max / sigma_min if sigma_min > 0.0 and sigma_max < np.inf else np.inf
    reducible_fraction = reduced / squared_gradient if squared_gradient > 0.0 else 1.0
    return (v[0], v[1], v[2]), condition, reducible_fraction


@compiled
def compute_controller_output(
    J: Floats,
    delta: Floats,
    bounds: Floats,
    follows_paper: bool,
    gain: float,
    max_condition: float,
    max_speed: float,
) -> tuple[ControllerOutput, float]:
    """Return the velocity by (32) and (31) with its quality, and √(2V).

    The error Δy (n,), the bounds b (n,) and the Jacobian (n, 3) are scaled. √(2V) is |Δy| without
    saturation. By (33) V decreases, while a single component may grow on the path.
    """
    gradient = compute_potential_gradient(delta, bounds, follows_paper)
    output = solve_velocity(J, gradient, gain, max_condition, max_speed)
    return output, np.sqrt(2.0 * compute_potential(delta, bounds, follows_paper))
