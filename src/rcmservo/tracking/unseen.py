"""Why a picture does not show the markers, in words for the person who set up the camera."""

import numpy as np

from rcmservo.interfaces import Image
from rcmservo.tracking.ball import Ball
from rcmservo.tracking.choice import Both, rivals
from rcmservo.tracking.close import balls_seen
from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.look import MarkerLook

DARK = 20
"""Grey levels: a picture is dark where hardly a pixel is brighter."""

GREY = 12
"""Grey levels: a picture is grey where no pixel's channels are further apart."""


def why_unseen(image: Image, look: MarkerLook) -> str:
    """One sentence, or nothing where both markers are seen."""
    if np.percentile(image, 99.0) < DARK:
        return "the picture is dark"
    if {look.colour_1, look.colour_2} != {"bright"} and np.ptp(image, axis=2).max() < GREY:
        return "the picture is grey, and the markers are known by their colours"
    first, second = (_found(image, colour) for colour in (look.colour_1, look.colour_2))
    if look.alike and len(first) < 2:
        return f"of two {look.colour_1} balls the picture shows {len(first)} whole"
    if not (first and second):
        return _missing(look, first, second)
    pairs = rivals(look, first, second)
    if len(pairs) > 1:
        return _ambiguous(look, pairs)
    return "" if pairs else _misfit(look, first[0], second[1 if look.alike else 0])


def _found(image: Image, colour: str) -> list[Ball]:
    return balls_seen(image, COLOURS.index(colour))


def _missing(look: MarkerLook, first: list[Ball], second: list[Ball]) -> str:
    names = [] if first else [f"no {look.colour_1} ball (marker 1)"]
    names += [] if second else [f"no {look.colour_2} ball (marker 2)"]
    return f"the picture shows {' and '.join(names)} whole"


def _ambiguous(look: MarkerLook, pairs: list[Both]) -> str:
    places = [
        f"{look.colour_1} at ({a.u:.0f}, {a.v:.0f}) with {look.colour_2} at ({b.u:.0f}, {b.v:.0f})"
        for a, b in pairs[:2]
    ]
    count = "two" if len(pairs) == 2 else str(len(pairs))
    return f"{count} pairs of balls can be the markers: {' or '.join(places)}; cover what is none"


def _misfit(look: MarkerLook, a: Ball, b: Ball) -> str:
    return (
        f"the {look.colour_1} and the {look.colour_2} ball have radii of {a.radius:.0f} and "
        f"{b.radius:.0f} px, which do not fit radius_1 {look.radius_1:g} mm and "
        f"radius_2 {look.radius_2:g} mm"
    )
