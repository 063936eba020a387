"""Where the second marker is, given the first: on a rigid shaft, or by the paper's constant factor
λ.

Both markers ride on the tool's axis, m₁ nearer the RCM and m₂ nearer the tip. The paper writes p₂ =
λ p₁; on a real shaft the spacing l is what stays, so p₂ = p₁ (1 + l/ρ) and λ changes with insertion
(by the wrong sign of ∂d/∂ρ).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from rcmservo.constraints import Checked, above, at_least, at_most, positive
from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled

RIGID, SCALED = 0, 1


class Shaft(NamedTuple):
    """What compiled functions know of a tool.

    Parameters
    ----------
    kind : int
        RIGID or SCALED.
    value : float
        l in mm of a rigid one, λ of a scaled one.
    """

    kind: int
    value: float


@compiled
def stretch(shaft: Shaft, p1: Floats | Point) -> float:
    """|p₂|/|p₁|: λ itself, or 1 + l/ρ."""
    if shaft.kind == SCALED:
        return shaft.value
    return 1.0 + shaft.value / np.sqrt(p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2)


@compiled
def second_marker(shaft: Shaft, p1: Floats) -> Floats:
    """p₂ (3,) mm from p₁ (3,) mm."""
    x, y, z = second_point(shaft, p1)
    return np.array([x, y, z])


@compiled
def second_point(shaft: Shaft, p1: Floats | Point) -> Point:
    """p₂ mm from p₁ (3,) mm, as three numbers."""
    reach = stretch(shaft, p1)
    return reach * p1[0], reach * p1[1], reach * p1[2]


@compiled
def fastest_point(shaft: Shaft, p1: Floats | Point, v: Floats | Point, tip: float) -> float:
    """Speed mm/s of the fastest of marker 1, which moves with v (3,) mm/s at p1 (3,) mm, marker 2,
    and the tip, which is `tip` mm beyond marker 2: it turns about the RCM with the tool.
    """
    squared = p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    along = v[0] * p1[0] + v[1] * p1[1] + v[2] * p1[2]
    total = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    radial = along * along / squared
    lever = max(stretch(shaft, p1) + tip / np.sqrt(squared), 1.0)
    return np.sqrt(radial + max(total - radial, 0.0) * lever**2)


@compiled
def second_marker_jacobian(shaft: Shaft, p1: Floats) -> Floats:
    """∂p₂/∂p₁ (3, 3): λ I, or I + (l/ρ)(I − n nᵀ) with n = p₁/ρ."""
    jacobian = np.zeros((3, 3))
    reach, squared = stretch(shaft, p1), p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    along = 0.0 if shaft.kind == SCALED else (reach - 1.0) / squared
    for i in range(3):
        jacobian[i, i] = reach
        for j in range(3):
            jacobian[i, j] -= along * p1[i] * p1[j]
    return jacobian


@compiled
def by_first_marker(shaft: Shaft, p1: Floats | Point, motion: Floats) -> None:
    """Make ∂m₂/∂p₂ (n, 3) to ∂m₂/∂p₁ in place: times `second_marker_jacobian`, which is a multiple
    of I but along p₁.
    """
    reach, squared = stretch(shaft, p1), p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    share = 0.0 if shaft.kind == SCALED else (reach - 1.0) / squared
    for k in range(len(motion)):
        along = share * (motion[k, 0] * p1[0] + motion[k, 1] * p1[1] + motion[k, 2] * p1[2])
        for i in range(3):
            motion[k, i] = reach * motion[k, i] - along * p1[i]


SHORTEST, LONGEST = 1.0, 1000.0
"""mm that a tool's lengths can have: what is beyond was given in another unit."""

OFFSET = at_most(LONGEST, "mm either way")


class Tool(Checked, ABC, section="tool"):
    """The markers' places on the tool's axis.

    ``offset`` (mm) is how far m₁ is beyond the reference point whose ρ the arm reports. ``value``
    is the number that the compiled functions take: l or λ.
    """

    kind: ClassVar[int]
    name: ClassVar[str]
    offset: float

    @property
    @abstractmethod
    def value(self) -> float:
        """L in mm, or λ."""

    @cached_property
    def shaft(self) -> Shaft:
        """What compiled functions know of it."""
        return Shaft(self.kind, float(self.value))

    def second_marker(self, p1: Floats) -> Floats:
        """p₂ (3,) mm of the marker nearer the tip."""
        return second_marker(self.shaft, np.ascontiguousarray(p1, dtype=float))


@dataclass(frozen=True)
class RigidTool(Tool):
    """Two markers at a fixed spacing l on one rigid shaft: p₂ = p₁ (1 + l/ρ).

    Parameters
    ----------
    spacing : float
        l, mm from m₁ to m₂ along the tool, away from the RCM.
    offset : float
        mm from the tool's reference point to m₁, positive away from the RCM.
    """

    kind = RIGID
    name = "rigid"

    spacing: Annotated[
        float,
        positive("length in mm"),
        at_least(SHORTEST, "mm (this looks like m)"),
        at_most(LONGEST, "mm (this looks like µm)"),
    ]
    offset: Annotated[float, OFFSET] = 0.0

    @property
    def value(self) -> float:
        return self.spacing


@dataclass(frozen=True)
class ScaledTool(Tool):
    """The paper's model p₂ = λ p₁ with λ constant: right at one insertion only, kept to reproduce
    the paper.

    Parameters
    ----------
    scale : float
        λ, above 1.
    offset : float
        mm from the tool's reference point to m₁, positive away from the RCM.
    """

    kind = SCALED
    name = "scaled"

    scale: Annotated[float, above(1.0, what="a factor λ")]
    offset: Annotated[float, OFFSET] = 0.0

    @property
    def value(self) -> float:
        return self.scale
