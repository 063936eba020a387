"""Explanation for the operator why the tracker does not find the markers in an image."""

import numpy as np

from rcmservo.interfaces import Image
from rcmservo.tracking.appearance import MarkerAppearance
from rcmservo.tracking.ball_fit import Ball
from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.local_search import detect_balls
from rcmservo.tracking.marker_identity import BallPair, find_candidate_pairs

MAX_DARK_LEVEL = 20
"""Grey level: an image is dark if 99 % of its values lie below."""

MAX_GREY_RANGE = 12
"""Grey levels: an image is grey if the channels of no pixel differ by so much."""


def explain_not_found(image: Image, appearance: MarkerAppearance) -> str:
    """Return the reason in one sentence, or an empty string if the image shows both markers."""
    if np.percentile(image, 99.0) < MAX_DARK_LEVEL:
        return "the picture is dark"
    colours = appearance.colour_1, appearance.colour_2
    if set(colours) != {"bright"} and np.ptp(image, axis=2).max() < MAX_GREY_RANGE:
        return "the picture is grey, and the markers are known by their colours"
    first, second = (_detect(image, colour) for colour in colours)
    if appearance.same_colour and len(first) < 2:
        return f"of two {appearance.colour_1} balls the picture shows {len(first)} whole"
    if not (first and second):
        return _missing_sentence(appearance, first, second)
    pairs = find_candidate_pairs(appearance, first, second)
    if len(pairs) > 1:
        return _ambiguity_sentence(appearance, pairs)
    other = second[1 if appearance.same_colour else 0]
    return "" if pairs else _size_sentence(appearance, first[0], other)


def _detect(image: Image, colour: str) -> list[Ball]:
    return detect_balls(image, COLOURS.index(colour))


def _missing_sentence(appearance: MarkerAppearance, first: list[Ball], second: list[Ball]) -> str:
    names = [] if first else [f"no {appearance.colour_1} ball (marker 1)"]
    names += [] if second else [f"no {appearance.colour_2} ball (marker 2)"]
    return f"the picture shows {' and '.join(names)} whole"


def _ambiguity_sentence(appearance: MarkerAppearance, pairs: list[BallPair]) -> str:
    colours = appearance.colour_1, appearance.colour_2
    places = [
        " with ".join(
            f"{colour} at ({ball.u:.0f}, {ball.v:.0f})"
            for colour, ball in zip(colours, pair, strict=True)
        )
        for pair in pairs[:2]
    ]
    count = "two" if len(pairs) == 2 else str(len(pairs))
    return f"{count} pairs of balls can be the markers: {' or '.join(places)}; cover what is none"


def _size_sentence(appearance: MarkerAppearance, a: Ball, b: Ball) -> str:
    return (
        f"the {appearance.colour_1} and the {appearance.colour_2} ball have radii of "
        f"{a.radius:.0f} and {b.radius:.0f} px, which do not fit radius_1 "
        f"{appearance.radius_1:g} mm and radius_2 {appearance.radius_2:g} mm"
    )
