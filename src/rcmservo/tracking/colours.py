"""Colour response of the pixels: a signed measure of a marker's colour.

The response to a primary colour is its channel minus the larger of the other two. The response to a
mixed colour is the smaller of its two channels minus the third. Grey of any brightness has the
response 0 to these colours, so balls stand out from it. The response to "bright" is the mean of the
channels.

This response is not linear: a pixel half covered by a ball may show less than half of the ball's
response, if another channel dominates the background. Where fractions of a pixel count, the linear
`CHANNEL_MIXES` replace it; grey has the response 0 to their colours too.
"""

import numpy as np

from rcmservo.interfaces import Floats, Image
from rcmservo.numerics.jit import compiled

COLOURS = ("red", "green", "blue", "yellow", "cyan", "magenta", "bright")
"""Names of the marker colours. Kernels use their index."""

CHANNEL_MIXES: Floats = np.array(
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
"""Linear mix of blue, green and red for each of `COLOURS`, (7, 3)."""


@compiled
def compute_pixel_response(blue: float, green: float, red: float, colour: int) -> float:
    """Return the response of one pixel to colour number `colour` of `COLOURS`, -255 to 255."""
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
def compute_colour_response(image: Image, colour: int) -> Floats:
    """Return the colour response (height, width) of an image (height, width, 3)."""
    height, width = image.shape[0], image.shape[1]
    result = np.empty((height, width))
    for i in range(height):
        for j in range(width):
            pixel = image[i, j]
            result[i, j] = compute_pixel_response(
                float(pixel[0]), float(pixel[1]), float(pixel[2]), colour
            )
    return result


@compiled
def halve_resolution(fine: Floats) -> Image:
    """Return a colour response at half the resolution, where specks and noise fade.

    Each value is the mean of 2 x 2 pixels, clipped to 0..255.
    """
    height, width = fine.shape[0] // 2, fine.shape[1] // 2
    result = np.empty((height, width), np.uint8)
    for i in range(height):
        for j in range(width):
            row, column = 2 * i, 2 * j
            upper = fine[row, column] + fine[row, column + 1]
            lower_1, lower_2 = fine[row + 1, column], fine[row + 1, column + 1]
            mean = 0.25 * (upper + lower_1 + lower_2)
            result[i, j] = np.uint8(min(max(mean, 0.0), 255.0))
    return result
