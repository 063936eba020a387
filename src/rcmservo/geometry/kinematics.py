"""Where an RCM mechanism holds its tool: eq. (1)-(2), their inverse, their derivative, and the
joint limits.

A configuration is q = [angle, angle, insertion] in rad, rad, mm. It turns the tool's axis n(q)
about the RCM, which is the origin, and slides it: a point at the distance ρ = insertion + zero
along the axis lies at p = ρ n. In both coordinate systems here the three columns of ∂p/∂q are
orthogonal, which makes joint rates a projection.
"""

from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from rcmservo.constraints import Checked, Limit, Triple, each, finite
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import length, product

SPHERICAL, PITCH_YAW = 0, 1
MIN_LEVER = 1e-3
"""Shortest |∂n/∂q_i| that joint rates divide by: below it (2) is singular and the axis direction
undefined."""

FULL_TURN, LONGEST_TRAVEL, LEAST_TRAVEL = 2.0 * np.pi, 2000.0, 1.0
"""rad and mm that limits can have: what is beyond was given in another unit."""


Point = tuple[float, float, float]
"""A point as compiled functions pass it on where no array is needed, mm."""


class Rcm(NamedTuple):
    """What compiled functions know of a mechanism and of one point on its tool.

    Parameters
    ----------
    kind : int
        Its coordinates: SPHERICAL or PITCH_YAW.
    zero : float
        mm: the point is at ρ = q₃ + zero.
    lower : tuple[float, float, float]
        The joints' lower limits, rad, rad, mm.
    upper : tuple[float, float, float]
        Their upper limits, rad, rad, mm.
    """

    kind: int
    zero: float
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


def floats(numbers: Sequence[float]) -> tuple[float, float, float]:
    """Three numbers as floats: compiled functions are compiled anew for whole numbers."""
    one, two, three = map(float, numbers)
    return one, two, three


@compiled
def apart(one: Point, other: Point) -> float:
    """Mm between two points."""
    return np.sqrt((one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2 + (one[2] - other[2]) ** 2)


@compiled
def direction(rcm: Rcm, q: Floats | Point) -> tuple[float, float, float]:
    """Unit direction n of the tool from the RCM outwards; eq. (2) divided by ρ."""
    if rcm.kind == SPHERICAL:
        theta, phi = q[0], q[1]
        return np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    yaw, pitch = q[0], q[1]
    return np.cos(pitch) * np.sin(yaw), -np.sin(pitch), -np.cos(pitch) * np.cos(yaw)


@compiled
def axis(rcm: Rcm, q: Floats) -> Floats:
    """N (3,)."""
    x, y, z = direction(rcm, q)
    return np.array([x, y, z])


@compiled
def axis_jacobian(rcm: Rcm, q: Floats | Point) -> tuple[Point, Point]:
    """∂n/∂(angle, angle), its two columns: orthogonal to each other and to n."""
    s1, c1, s2, c2 = np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1])
    if rcm.kind == SPHERICAL:
        return (c1 * c2, c1 * s2, -s1), (-s1 * s2, s1 * c2, 0.0)
    return (c2 * c1, 0.0, c2 * s1), (-s2 * s1, -c2, s2 * c1)


@compiled
def position(rcm: Rcm, q: Floats) -> Floats:
    """P = ρ n(q) in mm, eq. (2)."""
    x, y, z = point_at(rcm, q)
    return np.array([x, y, z])


@compiled
def point_at(rcm: Rcm, q: Floats | Point) -> Point:
    """P = ρ n(q) in mm, eq. (2), as three numbers."""
    x, y, z = direction(rcm, q)
    rho = q[2] + rcm.zero
    return rho * x, rho * y, rho * z


@compiled
def position_jacobian(rcm: Rcm, q: Floats | Point) -> Floats:
    """∂p/∂q, shape (3, 3), mm per rad, rad, mm."""
    jacobian, n, rho = np.empty((3, 3)), direction(rcm, q), q[2] + rcm.zero
    one, two = axis_jacobian(rcm, q)
    for i in range(3):
        jacobian[i, 0], jacobian[i, 1], jacobian[i, 2] = rho * one[i], rho * two[i], n[i]
    return jacobian


@compiled
def joints(rcm: Rcm, p: Floats) -> Floats:
    """The configuration q, insertion positive, that brings the point to p: the inverse of (2)."""
    rho = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    if rcm.kind == SPHERICAL:
        across = np.sqrt(p[0] ** 2 + p[1] ** 2)
        return np.array([np.arctan2(across, p[2]), np.arctan2(p[1], p[0]), rho - rcm.zero])
    along = np.sqrt(p[0] ** 2 + p[2] ** 2)
    return np.array([np.arctan2(p[0], -p[2]), np.arctan2(-p[1], along), rho - rcm.zero])


@compiled
def joint_rates(rcm: Rcm, q: Floats, v: Floats) -> Floats:
    """q̇ (rad/s, rad/s, mm/s) that moves the point with v mm/s; finite even where (2) is
    singular.
    """
    one, two, three = rates_of(rcm, q, v)
    return np.array([one, two, three])


@compiled
def rates_of(rcm: Rcm, q: Floats | Point, v: Floats) -> Point:
    """The same as three numbers."""
    rho = q[2] + rcm.zero
    shortest = (MIN_LEVER * rho) ** 2
    (x1, y1, z1), (x2, y2, z2) = axis_jacobian(rcm, q)
    return (
        along_column((rho * x1, rho * y1, rho * z1), v, shortest),
        along_column((rho * x2, rho * y2, rho * z2), v, shortest),
        along_column(direction(rcm, q), v, shortest),
    )


@compiled
def along_column(column: Point, v: Floats, shortest: float) -> float:
    """The rate of the joint that moves the point along a `column` of ∂p/∂q; `shortest` is the least
    square of a length that is divided by.
    """
    x, y, z = column
    return (x * v[0] + y * v[1] + z * v[2]) / max(x**2 + y**2 + z**2, shortest)


@compiled
def reachable(rcm: Rcm, q: Floats, slack: float) -> bool:
    """Whether the joints q (3,) are within their limits, but for a share `slack` of each range; NaN
    is not.
    """
    for i in range(3):
        beyond = slack * (rcm.upper[i] - rcm.lower[i])
        if not rcm.lower[i] - beyond <= q[i] <= rcm.upper[i] + beyond:
            return False
    return True


@compiled
def blocked(
    rcm: Rcm, q: Floats | Point, v: Floats, fastest: Floats | Point, horizon: float, share: float
) -> tuple[int, Point]:
    """The joint (or -1) whose limit stands in the way of v (3,) mm/s, and v's joint rates.

    The joints move at `fastest` (3,) at most. One stands in the way if its limit would be passed
    within `horizon` s, and if without it less than `share` of the speed is left.
    """
    wanted = rates_of(rcm, q, v)
    slower = 1.0
    for i in range(3):
        slower = max(slower, abs(wanted[i]) / fastest[i])
    joint = -1
    for i in range(3):
        if passes_limit(rcm, i, q[i] + wanted[i] / slower * horizon):
            joint = i
    if joint < 0:
        return -1, wanted
    rates = np.zeros(3)
    for i in range(3):
        if not passes_limit(rcm, i, q[i] + wanted[i] / slower * horizon):
            rates[i] = wanted[i] / slower
    left = length(product(position_jacobian(rcm, q), rates))
    return joint if left < share * length(v) / slower else -1, wanted


@compiled
def passes_limit(rcm: Rcm, i: int, ahead: float) -> bool:
    """Return whether joint i is beyond a limit where it will be."""
    return ahead > rcm.upper[i] or ahead < rcm.lower[i]


LIMITS = (
    each(finite(), "three finite numbers (rad, rad, mm)"),
    Limit(
        lambda q: max(abs(q[0]), abs(q[1])) <= FULL_TURN,
        "within ±2π rad in joints 1 and 2 (this looks like degrees)",
    ),
    Limit(
        lambda q: abs(q[2]) <= LONGEST_TRAVEL,
        f"within ±{LONGEST_TRAVEL:g} mm in joint 3 (this looks like µm)",
    ),
)
"""Limits of the joints' limits, which name the likely unit of impossible ones."""


@dataclass(frozen=True)
class JointLimits(Checked):
    """The configurations that the tool may take: lower <= q <= upper.

    Parameters
    ----------
    lower : Triple
        rad, rad, mm.
    upper : Triple
        rad, rad, mm; above `lower` in every joint.
    """

    lower: Annotated[Triple, *LIMITS]
    upper: Annotated[Triple, *LIMITS]

    def __post_init__(self) -> None:
        super().__post_init__()
        above = all(low < high for low, high in zip(self.lower, self.upper, strict=True))
        self.require(above, "upper", f"above lower {self.lower} in every joint")
        farthest = max(abs(self.lower[2]), abs(self.upper[2]))
        right = f"beyond ±{LEAST_TRAVEL:g} mm in joint 3 (this looks like m)"
        self.require(farthest >= LEAST_TRAVEL, "upper", right)

    @property
    def arrays(self) -> tuple[Floats, Floats]:
        """Lower (3,) and upper (3,)."""
        return np.array(self.lower), np.array(self.upper)


@dataclass(frozen=True)
class Kinematics(Checked, ABC):
    """What a robot knows of its own RCM mechanism: coordinates, limits, and where the insertion
    axis reads zero.

    Parameters
    ----------
    limits : JointLimits
        How far each joint may go.
    insertion_zero : float
        mm: ρ of the tool's reference point where the insertion joint reads zero.
    """

    kind: ClassVar[int]
    """SPHERICAL or PITCH_YAW, for compiled functions."""
    joint_names: ClassVar[tuple[str, str, str]]
    """Those of q's joints in their order, as records and sentences tell them."""
    name: ClassVar[str]
    """What files, records and sentences call these coordinates."""

    limits: JointLimits
    insertion_zero: Annotated[float, finite("length in mm")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        shortest = self.limits.lower[2] + self.insertion_zero
        above = f"above {-self.insertion_zero:g} mm, so that ρ > 0"
        require(shortest > 0.0, "lower[2]", self.limits.lower[2], above)

    def rcm(self, offset: float = 0.0) -> Rcm:
        """What compiled functions know of it and of the point `offset` mm beyond the reference
        point.
        """
        return Rcm(
            self.kind,
            float(self.insertion_zero + offset),
            floats(self.limits.lower),
            floats(self.limits.upper),
        )

    def position(self, q: Floats) -> Floats:
        """P (3,) mm of the tool's reference point, eq. (2)."""
        return position(self.rcm(), np.ascontiguousarray(q, dtype=float))

    def jacobian(self, q: Floats) -> Floats:
        """∂p/∂q (3, 3)."""
        return position_jacobian(self.rcm(), np.ascontiguousarray(q, dtype=float))

    def joints(self, p: Floats) -> Floats:
        """Q (3,) of the reference point's position p (3,) mm."""
        return joints(self.rcm(), np.ascontiguousarray(p, dtype=float))


@dataclass(frozen=True)
class SphericalRcm(Kinematics):
    """The paper's coordinates q = [θ φ ρ], eq. (1)-(2): singular at θ = 0, so its limits must leave
    that pose out.

    Parameters
    ----------
    limits : JointLimits
        By default 8° to 85°, a full turn, and 40 to 220 mm.
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
    """Yaw about y, pitch about x, insertion towards −z, as a da Vinci arm counts: regular at its
    home pose q = 0.

    Parameters
    ----------
    limits : JointLimits
        By default those of a da Vinci research kit's patient-side manipulator.
    """

    kind = PITCH_YAW
    joint_names = ("yaw", "pitch", "insertion")
    name = "pitch-yaw"

    limits: JointLimits = field(
        default=JointLimits(lower=(-1.588, -0.925, 40.0), upper=(1.588, 0.925, 240.0))
    )
