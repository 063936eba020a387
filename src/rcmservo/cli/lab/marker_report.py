"""Results of `rcmservo markers`: as JSON, as a table, and drawn in the image.

A candidate is a coloured ball that could be a marker of the tool. The tracker uses two of them, a
pair.
"""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from rcmservo.interfaces import Image
from rcmservo.tracking.ball_fit import SAME_BALL_RADII
from rcmservo.tracking.candidates import NO_BALL_MESSAGE, Candidate, TrackedPair

UNKNOWN_RADIUS_PX = 6.0
"""Radius (px) of the ring around a marker whose radius the tracker does not report."""

if TYPE_CHECKING:
    from rcmservo.figures.overlay import BallRing


def make_report(
    candidates: list[Candidate], pair: TrackedPair | None, is_written: bool
) -> dict[str, Any]:
    """Return the output of `rcmservo markers --json`.

    Returns
    -------
    dict
        candidates: balls in the image, best quality first, each with the colour in which it is
        detected best, its centre (u_px, v_px), its radius_px, and its quality, above 0 and at
        most 1; look: appearance of the markers that the tracker searched, None if no two balls
        qualify or the rig file has its own tracker; markers: centres (u, v) of markers 1 and 2 in
        px, None if the tracker does not detect both; why: the reason for this, empty if it detects
        both; written: True if the markers were written to the rig file.
    """
    balls = [
        {
            "colour": candidate.colour,
            "u_px": candidate.ball.u,
            "v_px": candidate.ball.v,
            "radius_px": candidate.ball.radius,
            "quality": candidate.ball.quality,
        }
        for candidate in candidates
    ]
    if pair is None:
        reason = "" if candidates else NO_BALL_MESSAGE
        appearance = markers = None
    else:
        reason = pair.reason
        appearance = None if pair.appearance is None else asdict(pair.appearance)
        markers = None if reason else [(float(u), float(v)) for u, v in pair.points]
    return {
        "candidates": balls,
        "look": appearance,
        "markers": markers,
        "why": reason,
        "written": is_written,
    }


def print_markers(console: Console, candidates: list[Candidate], summary: str) -> None:
    """Print the detected balls, if any, as a table, and the tracker's choice in words."""
    table = Table("colour")
    for title in ("u [px]", "v [px]", "radius [px]", "quality"):
        table.add_column(title, justify="right")
    for candidate in candidates:
        ball = candidate.ball
        numbers_px = (f"{number:.1f}" for number in (ball.u, ball.v, ball.radius))
        table.add_row(candidate.colour, *numbers_px, f"{ball.quality:.2f}")
    if candidates:
        console.print(table)
    console.print(summary, soft_wrap=True)


def draw_candidates(
    image: Image,
    candidates: list[Candidate],
    pair: TrackedPair | None,
    summary: str,
    numbered: bool,
) -> Image:
    """Return the image with a ring around each ball, those of the tracker first.

    Parameters
    ----------
    image : Image
        Image (h, w, 3).
    candidates : list of Candidate
        Detected balls.
    pair : TrackedPair or None
        Balls that the tracker uses as markers.
    summary : str
        Caption.
    numbered : bool
        True if it is known which ball is marker 1.

    Returns
    -------
    Image
        Copy of the image (h, w, 3) with rings, labels and caption.
    """
    from rcmservo.figures.overlay import BallRing, draw_balls

    rings = [] if pair is None else _make_tracked_rings(pair, numbered)
    for candidate in candidates:
        ball = candidate.ball
        if all(np.hypot(ball.u - r.u, ball.v - r.v) > SAME_BALL_RADII * r.radius for r in rings):
            label = f"{candidate.colour} {ball.quality:.2f}"
            rings.append(BallRing(ball.u, ball.v, ball.radius, label, False))
    return draw_balls(image, rings, summary)


def _make_tracked_rings(pair: TrackedPair, numbered: bool) -> "list[BallRing]":
    """Return a ring for each ball of the tracker that it has detected."""
    from rcmservo.figures.overlay import BallRing

    labels = ["1", "2"]
    if pair.appearance is not None:
        colours = pair.appearance.colour_1, pair.appearance.colour_2
        labels = [f"{n}: {colour}" if numbered else colour for n, colour in enumerate(colours, 1)]
    radii = np.nan_to_num(pair.radius, nan=UNKNOWN_RADIUS_PX)
    return [
        BallRing(float(u), float(v), float(radius), label, True)
        for (u, v), radius, label in zip(pair.points, radii, labels, strict=True)
        if np.isfinite(u)
    ]
