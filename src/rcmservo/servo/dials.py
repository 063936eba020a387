"""What the compiled parts of a step know of the servo's boxes, and what a person wants."""

from typing import NamedTuple

from rcmservo.compiled import compiled
from rcmservo.guard.gate import Gate
from rcmservo.guard.thresholds import Thresholds
from rcmservo.interfaces import Floats
from rcmservo.method.exploration import Exploration
from rcmservo.method.features import FEATURES
from rcmservo.method.kinematics import Rcm
from rcmservo.method.tool import Shaft
from rcmservo.rows import Row, Rows, flag, real, reals, whole


class Dials(Row):
    """What the compiled parts know of the servo's boxes."""

    kind: int = whole("", "the mechanism's coordinates")
    zero: float = real("mm", "ρ of marker 1 where the insertion joint reads zero")
    lower: Floats = reals(3, "rad, rad, mm", "the joints' lower limits")
    upper: Floats = reals(3, "rad, rad, mm", "the joints' upper limits")
    fastest: Floats = reals(3, "rad/s, rad/s, mm/s", "bounds on the joint rates")
    gain: float = real("1/s", "k of the law (31)")
    bounds: Floats = reals(FEATURES, "rad, px, px", "b of the potential (32)")
    printed: bool = flag("whether the potential is as printed")
    max_condition: float = real("", "condition of the scaled Ĵ above which the tool stands still")
    max_speed: float = real("mm/s", "cap on |v|")
    refinements: int = whole("", "steps after eq. (16)")
    rcm_printed: bool = flag("whether eq. (16) is as printed")
    rcm_condition: float = real("", "condition of eq. (16) up to which o_c is known")
    period: int = whole("ns", "from tick to tick")


@compiled
def rcm_of(c: Dials) -> Rcm:
    """The mechanism and marker 1."""
    lower, upper = c.lower, c.upper
    low, high = (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])
    return Rcm(c.kind, c.zero, low, high)


class Fixed(NamedTuple):
    """What no tick changes."""

    dials: Rows[Dials]
    """Mechanism, law and imaged RCM."""
    thresholds: Rows[Thresholds]
    """From where on something is a fault."""
    gate: Rows[Gate]
    """Bounds on every command."""
    exploration: Rows[Exploration]
    """The first motion."""
    shaft: Shaft
    """Where the markers are on the tool."""


class Asked(NamedTuple):
    """What a person wants at a tick."""

    points: Floats
    """The target's markers (2, 2) raw px."""
    shown: int
    """When it was shown, ns."""
    other: bool
    """Whether it is another target than at the last tick."""
    request: int
    """What is asked for, by its place in Request."""
