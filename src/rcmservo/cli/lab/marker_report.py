"""Results of `rcmservo markers`: as JSON, as a table, and drawn in the image."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from rcmservo.interfaces import Image
from rcmservo.tracking.appearance import MarkerAppearance
from rcmservo.tracking.candidates import NO_BALL_MESSAGE, SAME_BALL_RADII, Candidate, TrackedPair

if TYPE_CHECKING:
    from rcmservo.figures.overlay import BallRing


@dataclass(frozen=True)
class CandidateReport:
    """Ball that could be a marker.

    Parameters
    ----------
    colour : str
        Colour in which the ball is detected best.
    u_px : float
        Column of its centre.
    v_px : float
        Row of its centre.
    radius_px : float
        Radius of its outline.
    quality : float
        Quality of the detection, above 0 and at most 1.
    """

    colour: str
    u_px: float
    v_px: float
    radius_px: float
    quality: float


@dataclass(frozen=True)
class MarkersReport:
    """Output of `rcmservo markers --json`.

    Parameters
    ----------
    candidates : list[CandidateReport]
        Balls in the image, best quality first.
    look : MarkerAppearance or None
        Appearance of the markers that the tracker searched; None if no two balls qualify.
    markers : list[tuple[float, float]] or None
        Centres (u, v) of markers 1 and 2 in px; None if the tracker does not detect both.
    why : str
        Reason why the tracker does not detect both; empty if it does.
    written : bool
        True if the markers were written to the rig file.
    """

    candidates: list[CandidateReport]
    look: MarkerAppearance | None
    markers: list[tuple[float, float]] | None
    why: str
    written: bool


def make_report(found: list[Candidate], pair: TrackedPair | None, written: bool) -> MarkersReport:
    """Return the detected balls and markers as plain numbers."""
    has_pair = pair is not None and not pair.reason
    return MarkersReport(
        [
            CandidateReport(one.colour, one.ball.u, one.ball.v, one.ball.radius, one.ball.quality)
            for one in found
        ],
        pair.appearance if pair else None,
        [(float(u), float(v)) for u, v in pair.points] if pair and has_pair else None,
        pair.reason if pair else "" if found else NO_BALL_MESSAGE,
        written,
    )


def print_markers(console: Console, found: list[Candidate], words: str) -> None:
    """Print the detected balls as a table, and the tracker's choice in words."""
    if not found:
        console.print(NO_BALL_MESSAGE, soft_wrap=True)
        return
    table = Table("colour")
    for title in ("u [px]", "v [px]", "radius [px]", "quality"):
        table.add_column(title, justify="right")
    for one in found:
        ball = one.ball
        numbers = (f"{number:.1f}" for number in (ball.u, ball.v, ball.radius))
        table.add_row(one.colour, *numbers, f"{ball.quality:.2f}")
    console.print(table)
    console.print(words, soft_wrap=True)


def draw_candidates(
    image: Image, found: list[Candidate], pair: TrackedPair | None, words: str, numbered: bool
) -> Image:
    """Return the image with a ring around each ball, those of the tracker first.

    Parameters
    ----------
    image : Image
        Image (h, w, 3).
    found : list of Candidate
        Detected balls.
    pair : TrackedPair or None
        Balls that the tracker uses as markers.
    words : str
        Caption.
    numbered : bool
        True if it is known which ball is marker 1.
    """
    from rcmservo.figures.overlay import BallRing, draw_balls

    rings = [] if pair is None else _make_tracked_rings(pair, numbered)
    for one in found:
        ball = one.ball
        if all(np.hypot(ball.u - r.u, ball.v - r.v) > SAME_BALL_RADII * r.radius for r in rings):
            label = f"{one.colour} {ball.quality:.2f}"
            rings.append(BallRing(ball.u, ball.v, ball.radius, label, False))
    return draw_balls(image, rings, words if found else NO_BALL_MESSAGE)


def _make_tracked_rings(pair: TrackedPair, numbered: bool) -> "list[BallRing]":
    from rcmservo.figures.overlay import BallRing

    colours = pair.appearance.colour_1, pair.appearance.colour_2
    names = [f"{n}: {colour}" if numbered else colour for n, colour in enumerate(colours, 1)]
    return [
        BallRing(float(u), float(v), float(radius), name, True)
        for (u, v), radius, name in zip(pair.points, pair.radius, names, strict=True)
        if np.isfinite(u)
    ]
