"""How the scene looks: the tool's thickness, the colours, the light, the tissue, the sensor."""

from dataclasses import dataclass

import numpy as np

from rcmservo.errors import require

Colour = tuple[float, float, float]

NOT_NEGATIVE = (
    "marker_radii",
    "shaft_radius",
    "jaw_radius",
    "contrast",
    "relief",
    "specular",
    "read_noise",
)
POSITIVE = "texture", "lamp_radius", "reach", "exponent", "full_well"
FINITE = "light", "marker_colours", "shaft_colour", "jaw_colour", "tissue_colour"


@dataclass(frozen=True)
class Look:
    """How the scene looks. A radius of 0 mm is that of a body that is not there."""

    marker_radii: tuple[float, float] = (3.5, 3.5)
    """mm, the balls 1 and 2."""

    shaft_radius: float = 2.5
    """mm."""

    jaw_radius: float = 1.2
    """mm, from half way between marker 2 and the tip on."""

    marker_colours: tuple[Colour, Colour] = ((60.0, 185.0, 30.0), (205.0, 80.0, 25.0))
    """The balls 1 and 2: blue, green, red, as all colours here."""

    shaft_colour: Colour = (46.0, 44.0, 42.0)
    """The shaft's."""

    jaw_colour: Colour = (150.0, 150.0, 150.0)
    """The jaw's."""

    tissue_colour: Colour = (128.0, 132.0, 215.0)
    """The tissue's, on average."""

    texture: float = 150.0
    """mm after which the tissue's texture repeats."""

    contrast: float = 0.1
    """The spread of the tissue's brightness, as a share of it."""

    relief: float = 0.45
    """mm, the spread of the tissue's height."""

    light: tuple[float, float, float] = (35.0, -45.0, 0.0)
    """mm, the lamp's place in camera axes."""

    lamp_radius: float = 4.0
    """mm. A larger lamp makes softer shadows."""

    reach: float = 200.0
    """mm from the lamp at which what faces it has its nominal colour. Nearer, it gets at most
    twice as bright."""

    ambient: float = 0.2
    """The share of light that comes from everywhere."""

    specular: float = 0.8
    """The strength of highlights."""

    exponent: float = 50.0
    """The sharpness of highlights."""

    full_well: float = 12000.0
    """Electrons at grey level 255: they set the shot noise."""

    read_noise: float = 1.0
    """Grey levels of noise in the dark."""

    def __post_init__(self) -> None:
        for name in NOT_NEGATIVE:
            value = np.array(getattr(self, name))
            good = bool(((value >= 0) & (value < np.inf)).all())
            require(good, name, value, "finite and not negative")
        for name in POSITIVE:
            require(getattr(self, name) > 0, name, getattr(self, name), "positive")
        for name in FINITE:
            value = getattr(self, name)
            require(bool(np.isfinite(value).all()), name, value, "finite")
        require(0 <= self.ambient <= 1, "ambient", self.ambient, "between 0 and 1")
