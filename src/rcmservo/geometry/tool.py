"""Models of the tool: position of marker 2 relative to marker 1, on a rigid shaft or by a factor λ.

Both markers are on the tool's axis, m₁ nearer the RCM and m₂ nearer the tip. The paper writes p₂ =
λ p₁. On a real shaft the spacing l is constant, so p₂ = p₁ (1 + l/ρ), and λ changes with the
insertion. A constant λ gives ∂d/∂ρ the opposite sign.
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
"""Codes of the tool models in compiled functions."""


class ToolStruct(NamedTuple):
    """Tool model for compiled functions.

    Parameters
    ----------
    kind : int
        RIGID or SCALED.
    value : float
        Spacing l (mm) of a rigid tool, factor λ of a scaled one.
    """

    kind: int
    value: float


@compiled
def compute_marker_ratio(shaft: ToolStruct, p1: Floats | Point) -> float:
    """Return |p₂|/|p₁|: λ of a scaled tool, 1 + l/ρ of a rigid one."""
    if shaft.kind == SCALED:
        return shaft.value
    return 1.0 + shaft.value / np.sqrt(p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2)


@compiled
def compute_second_marker(shaft: ToolStruct, p1: Floats) -> Floats:
    """Return the position p₂ (3,) mm of marker 2 from that of marker 1, p₁ (3,) mm."""
    x, y, z = compute_second_marker_tuple(shaft, p1)
    return np.array([x, y, z])


@compiled
def compute_second_marker_tuple(shaft: ToolStruct, p1: Floats | Point) -> Point:
    """Return the position p₂ (mm) of marker 2 from that of marker 1, p₁, as a tuple."""
    ratio = compute_marker_ratio(shaft, p1)
    return ratio * p1[0], ratio * p1[1], ratio * p1[2]


@compiled
def compute_max_tool_speed(
    shaft: ToolStruct, p1: Floats | Point, v: Floats | Point, tip: float
) -> float:
    """Return the largest speed (mm/s) of marker 1, marker 2 and the tip.

    Marker 1 is at p1 (3,) mm and moves with v (3,) mm/s; the tip is `tip` mm beyond marker 2. The
    tool turns about the RCM, so speed across the axis grows with the distance from it.
    """
    squared = p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    along = v[0] * p1[0] + v[1] * p1[1] + v[2] * p1[2]
    total = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    radial = along * along / squared
    lever = max(compute_marker_ratio(shaft, p1) + tip / np.sqrt(squared), 1.0)
    return np.sqrt(radial + max(total - radial, 0.0) * lever**2)


@compiled
def compute_second_marker_jacobian(shaft: ToolStruct, p1: Floats) -> Floats:
    """Return ∂p₂/∂p₁ (3, 3): λ I, or I + (l/ρ)(I − n nᵀ) with n = p₁/ρ."""
    jacobian = np.zeros((3, 3))
    ratio, squared = compute_marker_ratio(shaft, p1), p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    along = 0.0 if shaft.kind == SCALED else (ratio - 1.0) / squared
    for i in range(3):
        jacobian[i, i] = ratio
        for j in range(3):
            jacobian[i, j] -= along * p1[i] * p1[j]
    return jacobian


@compiled
def convert_to_first_marker(shaft: ToolStruct, p1: Floats | Point, motion: Floats) -> None:
    """Convert ∂m₂/∂p₂ (n, 3) to ∂m₂/∂p₁ in place, by the chain rule.

    The factor ∂p₂/∂p₁ is a multiple of I plus a term along p₁, so its matrix is not needed.
    """
    ratio, squared = compute_marker_ratio(shaft, p1), p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    fraction = 0.0 if shaft.kind == SCALED else (ratio - 1.0) / squared
    for k in range(len(motion)):
        along = fraction * (motion[k, 0] * p1[0] + motion[k, 1] * p1[1] + motion[k, 2] * p1[2])
        for i in range(3):
            motion[k, i] = ratio * motion[k, i] - along * p1[i]


MIN_LENGTH_MM, MAX_LENGTH_MM = 1.0, 1000.0
"""Bounds of plausible tool lengths; other values were given in another unit."""

OFFSET_LIMIT = at_most(MAX_LENGTH_MM, "mm in either direction")


class Tool(Checked, ABC, section="tool"):
    """Base of the tool models: positions of both markers on the tool's axis.

    ``offset`` (mm) is the distance from the reference point, whose ρ the arm reports, to m₁.
    ``value`` is the parameter of the compiled functions: l or λ.
    """

    kind: ClassVar[int]
    name: ClassVar[str]
    offset: float

    @property
    @abstractmethod
    def value(self) -> float:
        """Spacing l in mm, or factor λ."""

    @cached_property
    def struct(self) -> ToolStruct:
        """Struct for compiled functions."""
        return ToolStruct(self.kind, float(self.value))

    def second_marker(self, p1: Floats) -> Floats:
        """Return the position of marker 2, the one nearer the tip.

        Parameters
        ----------
        p1 : Floats
            Position (3,) mm of marker 1, from the RCM.

        Returns
        -------
        Floats
            Position p₂ (3,) mm.
        """
        return compute_second_marker(self.struct, np.ascontiguousarray(p1, dtype=float))


@dataclass(frozen=True)
class RigidTool(Tool):
    """Tool with two markers at a fixed spacing l on a rigid shaft: p₂ = p₁ (1 + l/ρ).

    Parameters
    ----------
    spacing : float
        Spacing l (mm) from m₁ to m₂ along the tool, away from the RCM, from 1 to 1000.
    offset : float
        Distance (mm) from the tool's reference point to m₁, positive away from the RCM, at most
        1000 either way.

    Raises
    ------
    BadInput
        If a parameter is outside its range. The message names the likely unit.

    Notes
    -----
    The paper uses a constant factor λ instead, see `ScaledTool`.
    """

    kind = RIGID
    name = "rigid"

    spacing: Annotated[
        float,
        positive("length in mm"),
        at_least(MIN_LENGTH_MM, "mm (this looks like m)"),
        at_most(MAX_LENGTH_MM, "mm (this looks like µm)"),
    ]
    offset: Annotated[float, OFFSET_LIMIT] = 0.0

    @property
    def value(self) -> float:
        return self.spacing


@dataclass(frozen=True)
class ScaledTool(Tool):
    """Tool with the paper's model p₂ = λ p₁ of constant λ.

    A rigid shaft has this λ at one insertion only. The model is here to reproduce the paper.

    Parameters
    ----------
    scale : float
        Factor λ, above 1.
    offset : float
        Distance (mm) from the tool's reference point to m₁, positive away from the RCM, at most
        1000 either way.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    References
    ----------
    Section II-B of the paper, after eq. (2).
    """

    kind = SCALED
    name = "scaled"

    scale: Annotated[float, above(1.0, what="a factor λ")]
    offset: Annotated[float, OFFSET_LIMIT] = 0.0

    @property
    def value(self) -> float:
        return self.scale
