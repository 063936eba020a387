"""How the scene looks: the tool's thickness, the colours, the light, the tissue, the sensor."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from rcmservo.constraints import (
    Checked,
    Limit,
    Triple,
    between,
    each,
    finite,
    not_negative,
    positive,
)

Colour = tuple[float, float, float]

Light = NDArray[np.float32]
"""Light (H, W, 3) in grey levels, or a share of it (H, W)."""

NOT_NEGATIVE = not_negative()
FINITE_COLOUR = each(finite(), "three finite numbers (blue, green, red)")


@dataclass(frozen=True)
class Look(Checked):
    """How the scene looks. A radius of 0 mm is that of a body that is not there."""

    marker_radii: Annotated[
        tuple[float, float], each(not_negative(), "two numbers of mm that are not negative")
    ] = (3.5, 3.5)
    """mm, the balls 1 and 2."""

    shaft_radius: Annotated[float, NOT_NEGATIVE] = 2.5
    """mm."""

    jaw_radius: Annotated[float, NOT_NEGATIVE] = 1.2
    """mm, from half way between marker 2 and the tip on."""

    marker_colours: Annotated[
        tuple[Colour, Colour],
        each(FINITE_COLOUR, "two times three finite numbers (blue, green, red)"),
    ] = ((60.0, 185.0, 30.0), (205.0, 80.0, 25.0))
    """The balls 1 and 2: blue, green, red, as all colours here."""

    shaft_colour: Annotated[Colour, FINITE_COLOUR] = (46.0, 44.0, 42.0)
    """The shaft's."""

    jaw_colour: Annotated[Colour, FINITE_COLOUR] = (150.0, 150.0, 150.0)
    """The jaw's."""

    tissue_colour: Annotated[Colour, FINITE_COLOUR] = (128.0, 132.0, 215.0)
    """The tissue's, on average."""

    texture: Annotated[float, positive()] = 150.0
    """mm after which the tissue's texture repeats."""

    contrast: Annotated[float, NOT_NEGATIVE] = 0.1
    """The spread of the tissue's brightness, as a share of it."""

    relief: Annotated[float, NOT_NEGATIVE] = 0.45
    """mm, the spread of the tissue's height."""

    light: Annotated[Triple, each(finite(), "three finite numbers of mm")] = (35.0, -45.0, 0.0)
    """mm, the lamp's place in camera axes."""

    lamp_radius: Annotated[float, positive()] = 4.0
    """mm. A larger lamp makes softer shadows."""

    reach: Annotated[float, positive()] = 200.0
    """mm from the lamp at which what faces it has its nominal colour. Nearer, it gets at most
    twice as bright."""

    ambient: Annotated[float, between(0.0, 1.0, "a share")] = 0.2
    """The share of light that comes from everywhere."""

    specular: Annotated[float, NOT_NEGATIVE] = 0.8
    """The strength of highlights."""

    exponent: Annotated[float, positive()] = 50.0
    """The sharpness of highlights."""

    full_well: Annotated[float, Limit(lambda x: x > 0.0, "a positive number, or inf")] = 12000.0
    """Electrons at grey level 255: they set the shot noise."""

    read_noise: Annotated[float, NOT_NEGATIVE] = 1.0
    """Grey levels of noise in the dark."""
