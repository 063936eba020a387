"""What the compiled parts of a step know of the servo's boxes, and what a person wants."""

from dataclasses import dataclass
from typing import NamedTuple

from rcmservo.compiled import compiled
from rcmservo.guard.gate import Gate
from rcmservo.guard.thresholds import Thresholds
from rcmservo.interfaces import Floats
from rcmservo.method.exploration import Exploration
from rcmservo.method.features import FEATURES
from rcmservo.method.kinematics import Rcm
from rcmservo.method.tool import Shaft
from rcmservo.rows import Row, flag, real, reals, whole


class Dials(Row):
    """What the compiled parts know of the servo's boxes."""

    kind: int = whole("", "the mechanism's coordinates")
    zero: float = real("mm", "ρ of marker 1 where the insertion joint reads zero")
    lower: Floats = reals(3, "rad, rad, mm", "the joints' lower limits")
    upper: Floats = reals(3, "rad, rad, mm", "the joints' upper limits")
    fastest: Floats = reals(3, "rad/s, rad/s, mm/s", "bounds on the joint rates")
    gain: float = real("1/s", "k of the law (31)")
    features: int = whole("", "numbers that the law acts on: 3 of [s r d], more of the markers'")
    bounds: Floats = reals(FEATURES, "rad, px, px", "b of the potential (32)")
    printed: bool = flag("whether the potential is as printed")
    max_condition: float = real(
        "", "condition of the scaled Ĵ up to which its inverse is hardly damped"
    )
    max_speed: float = real("mm/s", "cap on the speed of both markers and of the tip")
    tip: float = real("mm", "from marker 2 to the tip")
    refinements: int = whole("", "steps after eq. (16)")
    rcm_printed: bool = flag("whether eq. (16) is as printed")
    rcm_condition: float = real("", "condition of eq. (16) up to which o_c is known")
    spares: bool = flag("whether the estimator goes on while one marker is lost")
    period: int = whole("ns", "from tick to tick")
    tool: int = whole("", "RIGID or SCALED")
    spacing: float = real("", "l in mm of a rigid tool, λ of a scaled one")


@compiled
def rcm_of(c: Dials) -> Rcm:
    """The mechanism and marker 1."""
    lower, upper = c.lower, c.upper
    low, high = (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])
    return Rcm(c.kind, c.zero, low, high)


@compiled
def shaft_of(c: Dials) -> Shaft:
    """Where the markers are on the tool."""
    return Shaft(c.tool, c.spacing)


@dataclass(frozen=True)
class Fixed:
    """What no tick changes. Compiled functions take it as one row."""

    dials: Dials
    """Mechanism, tool, law and imaged RCM."""
    thresholds: Thresholds
    """From where on something is a fault."""
    gate: Gate
    """Bounds on every command."""
    exploration: Exploration
    """The first motion."""


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
