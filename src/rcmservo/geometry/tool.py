"""Models of the tool: position of marker 2 relative to marker 1, on a rigid shaft or by a factor λ.

Both markers are on the tool's axis, marker 1 nearer the RCM and marker 2 nearer the tip, at p₁ and
p₂ from the RCM. The paper writes p₂ = λ p₁. On a real shaft the spacing l is constant, so that
p₂ = p₁ (1 + l/ρ) with ρ = |p₁|, and λ changes with the insertion. With a constant λ the imaged
distance d of the markers would change with ρ in the wrong direction.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from rcmservo.constraints import Checked, above, at_least, at_most, between, positive
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
    tool turns about the RCM, so the speed across the axis grows with the distance from the RCM.
    """
    squared_rho = p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    dot_product = v[0] * p1[0] + v[1] * p1[1] + v[2] * p1[2]
    squared_speed = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    squared_radial = dot_product * dot_product / squared_rho
    lever_ratio = max(compute_marker_ratio(shaft, p1) + tip / np.sqrt(squared_rho), 1.0)
    return np.sqrt(squared_radial + max(squared_speed - squared_radial, 0.0) * lever_ratio**2)


@compiled
def compute_second_marker_jacobian(shaft: ToolStruct, p1: Floats) -> Floats:
    """Return ∂p₂/∂p₁ (3, 3): λ I, or I + (l/ρ)(I − n nᵀ) with n = p₁/ρ."""
    jacobian = np.zeros((3, 3))
    ratio, squared_rho = compute_marker_ratio(shaft, p1), p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    axial = 0.0 if shaft.kind == SCALED else (ratio - 1.0) / squared_rho
    for i in range(3):
        jacobian[i, i] = ratio
        for j in range(3):
            jacobian[i, j] -= axial * p1[i] * p1[j]
    return jacobian


@compiled
def convert_to_first_marker(shaft: ToolStruct, p1: Floats | Point, motion: Floats) -> None:
    """Convert `motion` from ∂m₂/∂p₂ (n, 3) to ∂m₂/∂p₁ in place, by the chain rule.

    The factor ∂p₂/∂p₁ is a multiple of I plus a term along p₁, so its matrix is not needed.
    """
    ratio, squared_rho = compute_marker_ratio(shaft, p1), p1[0] ** 2 + p1[1] ** 2 + p1[2] ** 2
    axial = 0.0 if shaft.kind == SCALED else (ratio - 1.0) / squared_rho
    for k in range(len(motion)):
        along_p1 = axial * (motion[k, 0] * p1[0] + motion[k, 1] * p1[1] + motion[k, 2] * p1[2])
        for i in range(3):
            motion[k, i] = ratio * motion[k, i] - along_p1 * p1[i]


MIN_LENGTH_MM, MAX_LENGTH_MM = 1.0, 1000.0
"""Bounds of plausible lengths on a tool; a value outside them was given in another unit."""

OFFSET_LIMIT = between(-MAX_LENGTH_MM, MAX_LENGTH_MM, unit="mm")


class Tool(Checked, ABC, section="tool"):
    """Base of the tool models: positions of both markers on the tool's axis."""

    kind: ClassVar[int]
    """Code of the model in compiled functions: RIGID or SCALED."""
    name: ClassVar[str]
    """Name of the model in files, records and messages."""
    offset: float
    """Distance (mm) from the tool's reference point, whose ρ the arm reports, to marker 1."""

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

    p₁ and p₂ (3,) mm are the positions of the markers from the RCM, and ρ = |p₁| mm.

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

    p₁ and p₂ (3,) mm are the positions of the markers from the RCM. A rigid shaft with the spacing
    l mm has λ = 1 + l/ρ with ρ = |p₁|, a given λ therefore at one insertion only. The model is here
    to reproduce the paper; `RigidTool` is that of a real shaft.

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
