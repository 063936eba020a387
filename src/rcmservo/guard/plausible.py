"""Whether the markers are where the tool's motion puts them, and whether the estimate is right.

Every check is written so that NaN trips it.
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import largest, length, minus, over, product
from rcmservo.method.features import SCALE, about, difference, features

NO_PIXEL = 1e6
"""px from where on a coordinate is no marker's."""


@compiled
def lost(points: Floats) -> tuple[bool, bool]:
    """Whether marker 1 and marker 2 are lost: raw pixels (2, 2) not finite, or such as no camera
    has."""
    first = abs(points[0, 0]) < NO_PIXEL and abs(points[0, 1]) < NO_PIXEL
    second = abs(points[1, 0]) < NO_PIXEL and abs(points[1, 1]) < NO_PIXEL
    return not first, not second


@compiled
def placed(y: Floats, toward: float) -> Floats:
    """The markers (4,) px from o_c of the features y, on a line through it; `toward` is −1 if m₁
    lies beyond o_c."""
    c, s = np.cos(y[0]), np.sin(y[0])
    r, end = toward * y[1], toward * y[1] + y[2]
    return np.array([r * c, r * s, end * c, end * s])


@compiled
def misplaced(
    points: Floats,
    before: Floats,
    o_c: Floats,
    y: Floats,
    J_hat: Floats,
    delta_p: Floats,
    jump: float,
) -> tuple[bool, bool, bool]:
    """Whether marker 1, marker 2 are not where the motion Δp₁ puts them, and whether each is where
    the other should be.

    The markers' predicted motion follows from y + Ĵ Δp₁, as the imaged tool passes through o_c.
    """
    c, s = np.cos(y[0]), np.sin(y[0])
    toward = 1.0 if (before[0, 0] - o_c[0]) * c + (before[0, 1] - o_c[1]) * s >= 0.0 else -1.0
    foretold = product(J_hat, delta_p)
    for i in range(len(y)):
        foretold[i] += y[i]
    way = minus(placed(foretold, toward), placed(y, toward))
    off, crossed, there = np.empty(2), np.empty(2), np.empty((2, 2))
    for i in range(2):
        for k in range(2):
            there[i, k] = before[i, k] + way[2 * i + k]
    for i in range(2):
        allowed = jump + length(way[2 * i : 2 * i + 2])
        off[i] = apart(points[i], there[i]) - allowed
        crossed[i] = apart(points[i], there[1 - i]) - allowed
    return not off[0] <= 0.0, not off[1] <= 0.0, crossed[0] <= 0.0 and crossed[1] <= 0.0


@compiled
def leapt(
    points: Floats, before: Floats, delta_p: Floats, jump: float, nearest: float
) -> tuple[bool, bool, bool]:
    """The same without an estimate: whether they moved further than any camera sees a tool move by
    Δp₁ mm, which is `nearest` px a mm."""
    allowed = jump + nearest * length(delta_p)
    off = np.empty(2)
    crossed = np.empty(2)
    for i in range(2):
        off[i] = apart(points[i], before[i])
        crossed[i] = apart(points[i], before[1 - i])
    swapped = crossed[0] <= allowed and crossed[1] <= allowed
    return not off[0] <= allowed, not off[1] <= allowed, swapped


@compiled
def apart(one: Floats, other: Floats) -> float:
    """px between two points (2,)."""
    return np.sqrt((one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2)


@compiled
def judged(
    points: Floats,
    before: Floats,
    o_c: Floats,
    J_hat: Floats,
    delta_p: Floats,
    telling: float,
    wrong: float,
) -> int:
    """Whether the markers' change bears the estimate out (0) or not (1); −1 while the motion is too
    small to tell."""
    predicted = over(product(J_hat, delta_p), SCALE)
    size = largest(predicted)
    if size < telling:
        return -1
    change = difference(features(about(points, o_c)), features(about(before, o_c)))
    return 0 if largest(minus(over(change, SCALE), predicted)) <= telling + wrong * size else 1
