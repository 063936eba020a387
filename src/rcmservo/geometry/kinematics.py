"""Kinematics of RCM mechanisms, eq. (1)-(2): position, inverse, derivatives, and joint limits.

A configuration is q = [angle, angle, insertion] in rad, rad, mm. The angles turn the tool's axis
n(q) about the RCM, which is the origin; the insertion moves the tool along it. A point at the
distance ρ = insertion + zero along the axis is at p = ρ n. In both coordinate systems of this
module the three columns of ∂p/∂q are orthogonal, so a projection onto them gives the joint rates.
"""

from abc import ABC
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from rcmservo.constraints import Checked, Limit, Triple, each, finite
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_norm, multiply_vector

SPHERICAL, PITCH_YAW = 0, 1
"""Codes of the coordinate systems in compiled functions."""

MIN_LEVER = 1e-3
"""Smallest |∂n/∂q_i| that joint rates are divided by; below it eq. (2) is singular and the axis
direction undefined."""

FULL_TURN_RAD, MAX_TRAVEL_MM, MIN_TRAVEL_MM = 2.0 * np.pi, 2000.0, 1.0
"""Bounds of plausible joint limits, rad and mm; other values were given in another unit."""

Point = tuple[float, float, float]
"""Point in mm, as compiled functions pass it on where no array is needed."""


class RcmStruct(NamedTuple):
    """Mechanism and one point on its tool, for compiled functions.

    Parameters
    ----------
    kind : int
        Code of the coordinate system, SPHERICAL or PITCH_YAW.
    zero : float
        Distance ρ of the point from the RCM where the insertion reads zero, mm: ρ = q₃ + zero.
    lower : Triple
        Lower joint limits, rad, rad, mm.
    upper : Triple
        Upper joint limits, rad, rad, mm.
    """

    kind: int
    zero: float
    lower: Triple
    upper: Triple


@compiled
def compute_point_distance(a: Point, b: Point) -> float:
    """Return the distance between two points in mm."""
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@compiled
def compute_axis_tuple(rcm: RcmStruct, q: Floats | Point) -> Point:
    """Return the tool's unit direction n, from the RCM outwards: eq. (2) divided by ρ."""
    if rcm.kind == SPHERICAL:
        theta, phi = q[0], q[1]
        return np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    yaw, pitch = q[0], q[1]
    return np.cos(pitch) * np.sin(yaw), -np.sin(pitch), -np.cos(pitch) * np.cos(yaw)


@compiled
def compute_axis(rcm: RcmStruct, q: Floats) -> Floats:
    """Return the tool's unit direction n (3,), from the RCM outwards."""
    x, y, z = compute_axis_tuple(rcm, q)
    return np.array([x, y, z])


@compiled
def compute_axis_jacobian(rcm: RcmStruct, q: Floats | Point) -> tuple[Point, Point]:
    """Return the two columns of ∂n/∂(angle, angle); they are orthogonal to each other and to n."""
    s1, c1, s2, c2 = np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1])
    if rcm.kind == SPHERICAL:
        return (c1 * c2, c1 * s2, -s1), (-s1 * s2, s1 * c2, 0.0)
    return (c2 * c1, 0.0, c2 * s1), (-s2 * s1, -c2, s2 * c1)


@compiled
def compute_position(rcm: RcmStruct, q: Floats) -> Floats:
    """Return p = ρ n(q) (3,) in mm, eq. (2)."""
    x, y, z = compute_position_tuple(rcm, q)
    return np.array([x, y, z])


@compiled
def compute_position_tuple(rcm: RcmStruct, q: Floats | Point) -> Point:
    """Return p = ρ n(q) in mm, eq. (2), as a tuple."""
    x, y, z = compute_axis_tuple(rcm, q)
    rho = q[2] + rcm.zero
    return rho * x, rho * y, rho * z


@compiled
def compute_position_jacobian(rcm: RcmStruct, q: Floats | Point) -> Floats:
    """Return ∂p/∂q (3, 3); its columns are in mm/rad, mm/rad and mm/mm."""
    jacobian, n, rho = np.empty((3, 3)), compute_axis_tuple(rcm, q), q[2] + rcm.zero
    column_1, column_2 = compute_axis_jacobian(rcm, q)
    for i in range(3):
        jacobian[i, 0], jacobian[i, 1], jacobian[i, 2] = rho * column_1[i], rho * column_2[i], n[i]
    return jacobian


@compiled
def compute_joints(rcm: RcmStruct, p: Floats) -> Floats:
    """Return the configuration q (3,) that brings the point to p (3,) mm, the inverse of eq. (2).

    The distance ρ of the result is positive.
    """
    rho = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    if rcm.kind == SPHERICAL:
        from_polar_axis = np.sqrt(p[0] ** 2 + p[1] ** 2)
        return np.array([np.arctan2(from_polar_axis, p[2]), np.arctan2(p[1], p[0]), rho - rcm.zero])
    from_pitch_axis = np.sqrt(p[0] ** 2 + p[2] ** 2)
    return np.array([np.arctan2(p[0], -p[2]), np.arctan2(-p[1], from_pitch_axis), rho - rcm.zero])


@compiled
def compute_joint_rates(rcm: RcmStruct, q: Floats, v: Floats) -> Floats:
    """Return q̇ (3,) in rad/s, rad/s, mm/s that moves the point with the velocity v (3,) mm/s.

    The rates are finite even where eq. (2) is singular.
    """
    rate_1, rate_2, rate_3 = compute_joint_rates_tuple(rcm, q, v)
    return np.array([rate_1, rate_2, rate_3])


@compiled
def compute_joint_rates_tuple(rcm: RcmStruct, q: Floats | Point, v: Floats) -> Point:
    """Return q̇ (rad/s, rad/s, mm/s) for the velocity v (3,) mm/s as a tuple."""
    rho = q[2] + rcm.zero
    min_square = (MIN_LEVER * rho) ** 2
    (x1, y1, z1), (x2, y2, z2) = compute_axis_jacobian(rcm, q)
    rate_1 = project_on_column((rho * x1, rho * y1, rho * z1), v, min_square)
    rate_2 = project_on_column((rho * x2, rho * y2, rho * z2), v, min_square)
    return rate_1, rate_2, project_on_column(compute_axis_tuple(rcm, q), v, min_square)


@compiled
def project_on_column(column: Point, v: Floats, min_square: float) -> float:
    """Return the rate of the joint that moves the point along a `column` of ∂p/∂q.

    `min_square` is the smallest squared length of the column that the projection divides by.
    """
    x, y, z = column
    return (x * v[0] + y * v[1] + z * v[2]) / max(x**2 + y**2 + z**2, min_square)


@compiled
def is_within_limits(rcm: RcmStruct, q: Floats, tolerance: float) -> bool:
    """Return True if the joints q (3,) are within their limits.

    Each limit may be exceeded by the fraction `tolerance` of the joint's range. NaN gives False.
    """
    for i in range(3):
        margin = tolerance * (rcm.upper[i] - rcm.lower[i])
        if not rcm.lower[i] - margin <= q[i] <= rcm.upper[i] + margin:
            return False
    return True


@compiled
def find_blocking_joint(
    rcm: RcmStruct,
    q: Floats | Point,
    v: Floats,
    max_rates: Floats | Point,
    horizon: float,
    min_fraction: float,
) -> tuple[int, Point]:
    """Return the index of the joint whose limit blocks the velocity v (3,) mm/s, and v's rates.

    The index is -1 if no joint blocks. The joints move at `max_rates` (3,) at most. A joint blocks
    if it would pass its limit within `horizon` s, and if the other joints alone move the point at
    less than the fraction `min_fraction` of the speed.
    """
    requested = compute_joint_rates_tuple(rcm, q, v)
    slowdown = 1.0
    for i in range(3):
        slowdown = max(slowdown, abs(requested[i]) / max_rates[i])
    joint = -1
    for i in range(3):
        if is_beyond_limit(rcm, i, q[i] + requested[i] / slowdown * horizon):
            joint = i
    if joint < 0:
        return -1, requested
    free_rates = np.zeros(3)
    for i in range(3):
        if not is_beyond_limit(rcm, i, q[i] + requested[i] / slowdown * horizon):
            free_rates[i] = requested[i] / slowdown
    free_speed = compute_norm(multiply_vector(compute_position_jacobian(rcm, q), free_rates))
    return joint if free_speed < min_fraction * compute_norm(v) / slowdown else -1, requested


@compiled
def is_beyond_limit(rcm: RcmStruct, i: int, position: float) -> bool:
    """Return True if a position of joint i is outside its limits."""
    return position > rcm.upper[i] or position < rcm.lower[i]


JOINT_RANGE_LIMITS = (
    each(finite(), "three finite numbers (rad, rad, mm)"),
    Limit(
        lambda q: max(abs(q[0]), abs(q[1])) <= FULL_TURN_RAD,
        "within ±2π rad in joints 1 and 2 (this looks like degrees)",
    ),
    Limit(
        lambda q: abs(q[2]) <= MAX_TRAVEL_MM,
        f"within ±{MAX_TRAVEL_MM:g} mm in joint 3 (this looks like µm)",
    ),
)
"""Plausible values of joint limits; the messages name the likely unit of other values."""


@dataclass(frozen=True)
class JointLimits(Checked):
    """Joint limits of a mechanism: lower <= q <= upper.

    Parameters
    ----------
    lower : Triple
        Lower limits, rad, rad, mm; within ±2π rad and ±2000 mm.
    upper : Triple
        Upper limits, rad, rad, mm; above `lower` in every joint.

    Raises
    ------
    BadInput
        If a limit is not finite, is not above the lower one, or has an implausible size. The
        message names the likely unit.

    Notes
    -----
    Both fields are required. `SphericalRcm` and `PitchYawRcm` have default limits of their own.
    """

    lower: Annotated[Triple, *JOINT_RANGE_LIMITS]
    upper: Annotated[Triple, *JOINT_RANGE_LIMITS]

    def __post_init__(self) -> None:
        super().__post_init__()
        are_ordered = all(low < high for low, high in zip(self.lower, self.upper, strict=True))
        self.require(are_ordered, "upper", f"above lower {self.lower} in every joint")
        longest_mm = max(abs(self.lower[2]), abs(self.upper[2]))
        expected = f"beyond ±{MIN_TRAVEL_MM:g} mm in joint 3 (this looks like m)"
        self.require(longest_mm >= MIN_TRAVEL_MM, "upper", expected)

    @property
    def arrays(self) -> tuple[Floats, Floats]:
        """Lower and upper limits as arrays (3,), rad, rad, mm."""
        return np.array(self.lower, float), np.array(self.upper, float)


@dataclass(frozen=True)
class Kinematics(Checked, ABC):
    """Base of the RCM mechanisms: coordinates, joint limits and zero of the insertion, eq. (1)-(2).

    Parameters
    ----------
    limits : JointLimits
        Joint limits, rad, rad, mm.
    insertion_zero : float
        Distance ρ (mm) of the tool's reference point from the RCM where the insertion joint reads
        zero; it must leave ρ positive at the lower limit.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    References
    ----------
    Section II-B of the paper.
    """

    kind: ClassVar[int]
    """Code of the coordinates in compiled functions: SPHERICAL or PITCH_YAW."""
    joint_names: ClassVar[tuple[str, str, str]]
    """Names of the joints in the order of q, for records and messages."""
    name: ClassVar[str]
    """Name of the coordinates in files, records and messages."""

    limits: JointLimits
    insertion_zero: Annotated[float, finite("length in mm")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        min_rho = self.limits.lower[2] + self.insertion_zero
        expected = f"above {-self.insertion_zero:g} mm, so that ρ > 0"
        require(min_rho > 0.0, "lower[2]", self.limits.lower[2], expected)

    def to_struct(self, offset: float = 0.0) -> RcmStruct:
        """Return the struct of the point `offset` mm beyond the tool's reference point."""
        # floats, because compiled functions are compiled once more for integers
        (l1, l2, l3), (u1, u2, u3) = (array.tolist() for array in self.limits.arrays)
        zero = float(self.insertion_zero + offset)
        return RcmStruct(self.kind, zero, (l1, l2, l3), (u1, u2, u3))

    def position(self, q: Floats) -> Floats:
        """Return the position p (3,) mm of the tool's reference point, eq. (2).

        Parameters
        ----------
        q : Floats
            Configuration (3,), rad, rad, mm.

        Returns
        -------
        Floats
            Position (3,) mm from the RCM.
        """
        return compute_position(self.to_struct(), np.ascontiguousarray(q, dtype=float))

    def jacobian(self, q: Floats) -> Floats:
        """Return ∂p/∂q (3, 3) of the tool's reference point, the derivative of eq. (2).

        Parameters
        ----------
        q : Floats
            Configuration (3,), rad, rad, mm.

        Returns
        -------
        Floats
            Matrix (3, 3); its columns are in mm/rad, mm/rad and mm/mm.
        """
        return compute_position_jacobian(self.to_struct(), np.ascontiguousarray(q, dtype=float))

    def joints(self, p: Floats) -> Floats:
        """Return the configuration of a position, the inverse of eq. (2).

        Parameters
        ----------
        p : Floats
            Position (3,) mm of the tool's reference point, from the RCM.

        Returns
        -------
        Floats
            Configuration (3,), rad, rad, mm, with ρ = |p|. At p = 0, the RCM itself, ρ is 0 and the
            angles have no meaning.
        """
        return compute_joints(self.to_struct(), np.ascontiguousarray(p, dtype=float))


@dataclass(frozen=True)
class SphericalRcm(Kinematics):
    """Mechanism in the paper's spherical coordinates [θ φ ρ], eq. (1)-(2).

    The coordinates are eq. (1): θ rad is the angle of the tool's axis from the z axis, φ rad turns
    the axis about z, and ρ mm is the distance of a point of the tool from the RCM. Its position
    p (3,) mm from the RCM is eq. (2):

        p = ρ [sin θ cos φ, sin θ sin φ, cos θ]

    The joints are q = [θ φ q₃] (3,) in rad, rad, mm. The insertion q₃ is what the arm reports, and
    the tool's reference point has

        ρ = q₃ + insertion_zero

    With ``insertion_zero`` 0, the default, q is the paper's [θ φ ρ]. Marker 1 has
    ρ = q₃ + insertion_zero + offset, with the ``offset`` of the tool. The coordinates are singular
    at θ = 0, so the limits must exclude that pose; the constructor does not check it.

    Parameters
    ----------
    limits : JointLimits
        Limits of the joints q, rad, rad, mm; by default 0.140 to 1.484 rad (8° to 85°) for θ, −π to
        π for φ, and 40 to 220 mm for q₃, not for ρ.
    insertion_zero : float
        Distance ρ (mm) of the tool's reference point from the RCM where the insertion joint reads
        zero; it must leave ρ positive at the lower limit.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    References
    ----------
    Section II-B of the paper.
    """

    kind = SPHERICAL
    joint_names = ("theta", "phi", "rho")
    name = "spherical"

    limits: JointLimits = field(
        default=JointLimits(
            lower=(np.radians(8.0), -np.pi, 40.0), upper=(np.radians(85.0), np.pi, 220.0)
        )
    )


@dataclass(frozen=True)
class PitchYawRcm(Kinematics):
    """Mechanism with yaw about y, pitch about x and insertion towards −z, as in a da Vinci arm.

    A point of the tool is at p = ρ [cos β sin α, −sin β, −cos β cos α] for q = [α, β, insertion]
    and ρ = insertion + insertion_zero. This position takes the place of eq. (2) in the methods. The
    coordinates are regular at the home pose α = β = 0, and singular at β = ±90°. The limits must
    exclude these poses; the constructor does not check it.

    Parameters
    ----------
    limits : JointLimits
        Joint limits, rad, rad, mm; by default those of a da Vinci research kit's patient-side
        manipulator: ±1.588 rad (±91°) for α, ±0.925 rad (±53°) for β, and 40 to 240 mm.
    insertion_zero : float
        Distance ρ (mm) of the tool's reference point from the RCM where the insertion joint reads
        zero; it must leave ρ positive at the lower limit.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    References
    ----------
    Kazanzides et al., "An open-source research kit for the da Vinci Surgical System", ICRA 2014.
    """

    kind = PITCH_YAW
    joint_names = ("yaw", "pitch", "insertion")
    name = "pitch-yaw"

    limits: JointLimits = field(
        default=JointLimits(lower=(-1.588, -0.925, 40.0), upper=(1.588, 0.925, 240.0))
    )
