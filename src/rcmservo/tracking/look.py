"""What the two markers look like, and whether two balls in a picture can be they."""

from dataclasses import dataclass

from rcmservo.errors import require
from rcmservo.tracking.ball import Ball
from rcmservo.tracking.colours import COLOURS

APART = 1.1
"""The least ratio of radii that tells markers of one colour apart."""


@dataclass(frozen=True)
class MarkerLook:
    """What the two balls look like. Marker 1 is the one nearer the RCM.

    Two balls of one colour are told apart by their imaged size, so the larger one must look larger
    too. A tool that points its smaller ball steeply at the camera breaks that.
    """

    colour_1: str = "green"
    """One of COLOURS."""

    colour_2: str = "blue"
    """One of COLOURS."""

    radius_1: float = 4.0
    """mm. Only the ratio of the two radii matters."""

    radius_2: float = 4.0
    """mm."""

    def __post_init__(self) -> None:
        allowed = "one of " + ", ".join(COLOURS)
        require(self.colour_1 in COLOURS, "colour_1", self.colour_1, allowed)
        require(self.colour_2 in COLOURS, "colour_2", self.colour_2, allowed)
        for name in ("radius_1", "radius_2"):
            radius = getattr(self, name)
            require(0.01 <= radius <= 1000.0, name, radius, "a length from 0.01 to 1000 mm")
        ratio = max(self.ratio, 1.0 / self.ratio)
        right = (
            f"at least {APART} times larger or smaller than radius_1 where the colours are the same"
        )
        require(not self.alike or ratio >= APART, "radius_2", self.radius_2, right)

    @property
    def alike(self) -> bool:
        """Whether only their size tells the markers apart."""
        return self.colour_1 == self.colour_2

    @property
    def ratio(self) -> float:
        """The radius of marker 1 over that of marker 2."""
        return self.radius_1 / self.radius_2

    def fits(self, a: Ball, b: Ball) -> bool:
        """Whether two balls can be markers 1 and 2 by their sizes.

        Neither marker is twice as near as the other.
        """
        ratio = a.radius / b.radius
        if not 0.5 < ratio / self.ratio < 2.0:
            return False
        if not self.alike:
            return True
        apart = a.distance(b) > 0.5 * (a.radius + b.radius)
        return apart and (ratio > 1.04 if self.ratio > 1.0 else ratio < 1.0 / 1.04)
