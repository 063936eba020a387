"""How much of a marker's colour is in a pixel: a signed weight.

The weight of a primary colour is its channel minus the larger of the other two. The weight of a
mixed colour is the smaller of its two channels minus the third. "bright" is the plain mean. In
colours, grey weighs 0 however bright it is. So balls are found among other colours.

A pixel that a ball covers by half does not weigh half as much before a background in which another
channel is the larger one. Where fractions of a pixel count, MIXES are taken: linear, and grey is 0
in them too.
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats, Image

COLOURS = ("red", "green", "blue", "yellow", "cyan", "magenta", "bright")

MIXES: Floats = np.array(
    [
        [-0.5, -0.5, 1.0],
        [-0.5, 1.0, -0.5],
        [1.0, -0.5, -0.5],
        [-1.0, 0.5, 0.5],
        [0.5, 0.5, -1.0],
        [0.5, -1.0, 0.5],
        [1 / 3, 1 / 3, 1 / 3],
    ]
)
"""What each of COLOURS makes of blue, green and red."""


@compiled
def weight(blue: float, green: float, red: float, colour: int) -> float:
    """The amount of colour number `colour` of COLOURS in one pixel, -255 to 255."""
    result = (blue + green + red) / 3.0
    if colour == 0:
        result = red - max(green, blue)
    elif colour == 1:
        result = green - max(red, blue)
    elif colour == 2:
        result = blue - max(red, green)
    elif colour == 3:
        result = min(red, green) - blue
    elif colour == 4:
        result = min(green, blue) - red
    elif colour == 5:
        result = min(red, blue) - green
    return result


@compiled
def weights(image: Image, colour: int) -> Floats:
    """The weight of every pixel of `image` (height, width, 3)."""
    height, width = image.shape[0], image.shape[1]
    result = np.empty((height, width))
    for i in range(height):
        for j in range(width):
            pixel = image[i, j]
            result[i, j] = weight(float(pixel[0]), float(pixel[1]), float(pixel[2]), colour)
    return result


@compiled
def halved(fine: Floats) -> Image:
    """Weights at half the resolution, in which specks and noise fade.

    Each is the mean of 2 x 2 pixels, cut to 0..255.
    """
    height, width = fine.shape[0] // 2, fine.shape[1] // 2
    result = np.empty((height, width), np.uint8)
    for i in range(height):
        for j in range(width):
            k, l = 2 * i, 2 * j
            mean = 0.25 * (fine[k, l] + fine[k, l + 1] + fine[k + 1, l] + fine[k + 1, l + 1])
            result[i, j] = np.uint8(min(max(mean, 0.0), 255.0))
    return result
