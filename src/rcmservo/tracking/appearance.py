"""Appearance of the two markers: their colours and sizes."""

from dataclasses import dataclass
from typing import Annotated

from rcmservo.constraints import Checked, between, one_of
from rcmservo.tracking.colours import COLOURS

MIN_RADIUS_RATIO = 1.1
"""Smallest ratio of the radii of two markers of one colour."""

RADIUS_LIMIT = between(0.01, 1000.0, "a length", "mm")


@dataclass(frozen=True)
class MarkerAppearance(Checked):
    """Colours and sizes of the two balls. Marker 1 is the one nearer the RCM.

    The tracker distinguishes two balls of one colour by their size in the image, so the larger one
    must also look larger. This fails if the tool points its smaller ball steeply at the camera.

    Parameters
    ----------
    colour_1 : str
        Colour of marker 1: red, green, blue, yellow, cyan, magenta or bright.
    colour_2 : str
        Colour of marker 2: red, green, blue, yellow, cyan, magenta or bright.
    radius_1 : float
        Radius of marker 1 in mm, 0.01 to 1000. Only the ratio of the two radii matters.
    radius_2 : float
        Radius of marker 2 in mm, 0.01 to 1000.

    Raises
    ------
    BadInput
        If a colour or radius is outside its range, or if markers of one colour have radii with a
        ratio below 1.1.
    """

    colour_1: Annotated[str, one_of(COLOURS)] = "green"

    colour_2: Annotated[str, one_of(COLOURS)] = "blue"

    radius_1: Annotated[float, RADIUS_LIMIT] = 4.0

    radius_2: Annotated[float, RADIUS_LIMIT] = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        ratio = max(self.ratio, 1.0 / self.ratio)
        expected = (
            f"at least {MIN_RADIUS_RATIO} times larger or smaller than radius_1 of the same colour"
        )
        self.require(not self.same_colour or ratio >= MIN_RADIUS_RATIO, "radius_2", expected)

    @property
    def same_colour(self) -> bool:
        """True if both markers have one colour, so that only their size distinguishes them."""
        return self.colour_1 == self.colour_2

    @property
    def ratio(self) -> float:
        """Radius of marker 1 divided by the radius of marker 2."""
        return self.radius_1 / self.radius_2
