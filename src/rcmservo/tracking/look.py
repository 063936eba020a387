"""What the two markers look like, and whether two balls in a picture can be they."""

from dataclasses import dataclass
from typing import Annotated

from rcmservo.constraints import Checked, between, one_of
from rcmservo.tracking.ball import Ball
from rcmservo.tracking.colours import COLOURS

APART = 1.1
"""The least ratio of radii that tells markers of one colour apart."""

RADIUS = between(0.01, 1000.0, "a length", "mm")


@dataclass(frozen=True)
class MarkerLook(Checked):
    """What the two balls look like. Marker 1 is the one nearer the RCM.

    Two balls of one colour are told apart by their imaged size, so the larger one must look larger
    too. A tool that points its smaller ball steeply at the camera breaks that.
    """

    colour_1: Annotated[str, one_of(COLOURS)] = "green"
    """One of COLOURS."""

    colour_2: Annotated[str, one_of(COLOURS)] = "blue"
    """One of COLOURS."""

    radius_1: Annotated[float, RADIUS] = 4.0
    """mm. Only the ratio of the two radii matters."""

    radius_2: Annotated[float, RADIUS] = 4.0
    """mm."""

    def __post_init__(self) -> None:
        super().__post_init__()
        ratio = max(self.ratio, 1.0 / self.ratio)
        right = f"at least {APART} times larger or smaller than radius_1 of the same colour"
        self.require(not self.alike or ratio >= APART, "radius_2", right)

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
