"""What `rcmservo markers` has found: as JSON, as a table, and drawn in the picture."""

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
    """A ball that could be a marker.

    Parameters
    ----------
    colour : str
        The colour that shows it best.
    u_px : float
        Of its centre.
    v_px : float
        Of its centre.
    radius_px : float
        Of its outline.
    quality : float
        How well it is seen: above 0, at most 1.
    """

    colour: str
    u_px: float
    v_px: float
    radius_px: float
    quality: float


@dataclass(frozen=True)
class MarkersReport:
    """What `rcmservo markers --json` tells.

    Parameters
    ----------
    candidates : list[CandidateReport]
        The balls of the picture, best seen first.
    look : MarkerLook or None
        The markers that the tracker looked for; None where no two balls could be.
    markers : list[tuple[float, float]] or None
        The centres (u, v) px of markers 1 and 2; None where the tracker does not take two.
    why : str
        Why it does not; empty where it does.
    written : bool
        Whether the markers were written into the rig file.
    """

    candidates: list[CandidateReport]
    look: MarkerAppearance | None
    markers: list[tuple[float, float]] | None
    why: str
    written: bool


def markers_report(
    found: list[Candidate], pair: TrackedPair | None, written: bool
) -> MarkersReport:
    """What was found as plain numbers."""
    good = pair is not None and not pair.reason
    return MarkersReport(
        [
            CandidateReport(one.colour, one.ball.u, one.ball.v, one.ball.radius, one.ball.quality)
            for one in found
        ],
        pair.appearance if pair else None,
        [(float(u), float(v)) for u, v in pair.points] if pair and good else None,
        pair.reason if pair else "" if found else NO_BALL_MESSAGE,
        written,
    )


def print_markers(console: Console, found: list[Candidate], words: str) -> None:
    """What was found as a table, and in words what the tracker makes of it."""
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
    """The picture with the balls ringed, first those that the tracker takes; `numbered` where it is
    known which one is marker 1.
    """
    from rcmservo.figures.overlay import BallRing, draw_balls

    rings = [] if pair is None else _tracked_rings(pair, numbered)
    for one in found:
        ball = one.ball
        if all(np.hypot(ball.u - r.u, ball.v - r.v) > SAME_BALL_RADII * r.radius for r in rings):
            named = f"{one.colour} {ball.quality:.2f}"
            rings.append(BallRing(ball.u, ball.v, ball.radius, named, False))
    return draw_balls(image, rings, words if found else NO_BALL_MESSAGE)


def _tracked_rings(pair: TrackedPair, numbered: bool) -> "list[BallRing]":
    from rcmservo.figures.overlay import BallRing

    colours = pair.appearance.colour_1, pair.appearance.colour_2
    names = [f"{n}: {colour}" if numbered else colour for n, colour in enumerate(colours, 1)]
    return [
        BallRing(float(u), float(v), float(radius), name, True)
        for (u, v), radius, name in zip(pair.points, pair.radius, names, strict=True)
        if np.isfinite(u)
    ]
