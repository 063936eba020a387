"""Appearance of a rendered scene: tool geometry, colours, light, tissue and sensor noise."""

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
"""Blue, green and red, in grey levels from 0 (dark) to 255 (saturated)."""

Light = NDArray[np.float32]
"""Light (H, W, 3) in grey levels, or a fraction (H, W) of it."""

NOT_NEGATIVE = not_negative()
MARKER_RADII_LIMIT = each(NOT_NEGATIVE, "two numbers of mm that are not negative")
FINITE_COLOUR = each(finite(), "three finite numbers (blue, green, red)")
MARKER_COLOURS_LIMIT = each(FINITE_COLOUR, "two times three finite numbers (blue, green, red)")


@dataclass(frozen=True)
class Appearance(Checked):
    """Appearance of a rendered scene.

    A part of the tool with a radius of 0 mm is absent. All numbers but colours and the lamp's
    position must not be negative.

    Parameters
    ----------
    marker_radii : tuple[float, float]
        Radii of the balls 1 and 2, which are the markers, mm.
    shaft_radius : float
        Radius of the shaft, mm.
    jaw_radius : float
        Radius (mm) of the jaw: the end of the tool, from half-way between marker 2 and the tip on.
    marker_colours : tuple[Colour, Colour]
        Colours (blue, green, red) of the balls 1 and 2, grey levels.
    shaft_colour : Colour
        Colour (blue, green, red) of the shaft, grey levels.
    jaw_colour : Colour
        Colour (blue, green, red) of the jaw, grey levels.
    tissue_colour : Colour
        Mean colour (blue, green, red) of the tissue, grey levels.
    texture : float
        Period (mm) of the tissue's texture, positive.
    contrast : float
        Relative standard deviation of the tissue's brightness.
    relief : float
        Standard deviation (mm) of the tissue's height.
    light : Triple
        Position (mm) of the lamp in camera axes.
    lamp_radius : float
        Radius (mm) of the lamp, positive. A larger lamp makes softer shadows.
    reach : float
        Distance (mm), positive, from the lamp at which a surface that faces it has its nominal
        colour. A nearer surface is at most twice as bright.
    ambient : float
        Fraction of ambient light, 0 to 1.
    specular : float
        Intensity of specular highlights, as a fraction of grey level 255.
    exponent : float
        Exponent of specular highlights, positive: larger is sharper.
    full_well : float
        Electrons at grey level 255, positive, which determine the shot noise; inf for none.
    read_noise : float
        Standard deviation (grey levels) of the noise in the dark.

    Raises
    ------
    BadInput
        If a field is outside its range.
    """

    marker_radii: Annotated[tuple[float, float], MARKER_RADII_LIMIT] = (3.5, 3.5)

    shaft_radius: Annotated[float, NOT_NEGATIVE] = 2.5

    jaw_radius: Annotated[float, NOT_NEGATIVE] = 1.2

    marker_colours: Annotated[tuple[Colour, Colour], MARKER_COLOURS_LIMIT] = (
        (60.0, 185.0, 30.0),
        (205.0, 80.0, 25.0),
    )

    shaft_colour: Annotated[Colour, FINITE_COLOUR] = (46.0, 44.0, 42.0)

    jaw_colour: Annotated[Colour, FINITE_COLOUR] = (150.0, 150.0, 150.0)

    tissue_colour: Annotated[Colour, FINITE_COLOUR] = (128.0, 132.0, 215.0)

    texture: Annotated[float, positive()] = 150.0

    contrast: Annotated[float, NOT_NEGATIVE] = 0.1

    relief: Annotated[float, NOT_NEGATIVE] = 0.45

    light: Annotated[Triple, each(finite(), "three finite numbers of mm")] = (35.0, -45.0, 0.0)

    lamp_radius: Annotated[float, positive()] = 4.0

    reach: Annotated[float, positive()] = 200.0

    ambient: Annotated[float, between(0.0, 1.0, "a fraction")] = 0.2

    specular: Annotated[float, NOT_NEGATIVE] = 0.8

    exponent: Annotated[float, positive()] = 50.0

    full_well: Annotated[float, Limit(lambda x: x > 0.0, "a positive number, or inf")] = 12000.0

    read_noise: Annotated[float, NOT_NEGATIVE] = 1.0
