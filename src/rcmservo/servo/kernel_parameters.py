"""Parts of a servo as compiled functions read them, and the target with the operator's request."""

from dataclasses import dataclass
from typing import NamedTuple

from rcmservo.compiled import compiled
from rcmservo.guard.gate import Gate
from rcmservo.guard.thresholds import Thresholds
from rcmservo.interfaces import Floats
from rcmservo.method.controller import SaturatedController
from rcmservo.method.exploration import Exploration
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.method.kinematics import Rcm
from rcmservo.method.tool import Shaft


@dataclass(frozen=True)
class KernelParameters:
    """Settings of a servo's parts, which no tick changes. Compiled functions take them as one
    row."""

    rcm: Rcm
    """Mechanism, with marker 1 as the point on its tool."""
    tool: Shaft
    """Position of marker 2 on the tool."""
    controller: SaturatedController
    """Control law."""
    features: int
    """Numbers that the law acts on: 3 of [s r d], more of the markers'."""
    printed_potential: bool
    """Whether the potential (32) is as printed."""
    imaged_rcm: ImagedRcm
    """Solution of eq. (16)."""
    printed_rcm: bool
    """Whether eq. (16) is as printed."""
    spares_marker: bool
    """Whether the estimator goes on while one marker is lost."""
    gate: Gate
    """Bounds on every command."""
    thresholds: Thresholds
    """Values from which on something is a fault."""
    exploration: Exploration
    """First motion."""
    period: int
    """Time from tick to tick, ns."""


@compiled
def rcm_of(parameters: KernelParameters) -> Rcm:
    """Return the mechanism and marker 1."""
    known = parameters.rcm
    lower, upper = known.lower, known.upper
    low, high = (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])
    return Rcm(known.kind, known.zero, low, high)


@compiled
def shaft_of(parameters: KernelParameters) -> Shaft:
    """Return where the markers are on the tool."""
    return Shaft(parameters.tool.kind, parameters.tool.value)


class Asked(NamedTuple):
    """What a person wants at a tick."""

    points: Floats
    """The target's markers (2, 2) raw px."""
    q: Floats
    """The joints (3,) while it was shown."""
    shown: int
    """When it was shown, ns."""
    other: bool
    """Whether it is another target than at the last tick."""
    request: int
    """What is asked for, by its place in Request."""
    jog: Floats
    """The joint rates (3,) rad/s, rad/s, mm/s at which the arm is to go where that is JOG."""
