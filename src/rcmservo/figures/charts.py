"""Figures as data, and how they are drawn: in one style, for colour-blind eyes and in grey too.

A figure is plain numbers and words. It can be kept, compared bit for bit and drawn again.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rcmservo.config.files import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

MAX_POINTS = 500
"""Points of a curve beyond which it is thinned: more cannot be seen."""

Dashes = str | tuple[int, tuple[int, ...]]
"""A line's dashes, in Matplotlib's words."""


class Style(NamedTuple):
    """How a curve is drawn."""

    colour: str
    """Its colour."""

    dashes: Dashes
    """The dashes of its line."""

    width: float
    """Points, that of its line."""

    marker: str
    """The mark at its points, where it has no line."""


STYLES = (
    Style("#0072b2", "-", 1.5, "o"),
    Style("#d55e00", "--", 1.5, "s"),
    Style("#009e73", "-.", 1.5, "^"),
    Style("#000000", ":", 1.7, "D"),
    Style("#cc79a7", (0, (5, 1, 1, 1, 1, 1)), 1.5, "v"),
    Style("#e69f00", (0, (8, 2)), 1.5, "P"),
    Style("#56b4e9", (0, (2, 1)), 1.5, "X"),
)
"""Colours after Okabe and Ito. Every style has its own dashes and its own marker too."""

MEASURED = Style("#999999", "-", 2.6, ".")
"""Of the measured curve, on which an estimate is laid."""

TONES = ("#999999", "#d0d0d0", "#56b4e9", "#009e73", "#f0e442", "#e69f00", "#d55e00", "#cc79a7")
"""Colours of bands and bars, from harmless to grave, and that of a person's own motion."""

RC: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.framealpha": 0.85,
    "svg.hashsalt": "rcmservo",
}


@dataclass(frozen=True)
class Curve:
    """A line, or points."""

    label: str
    """What the legend calls it; empty where it does not."""

    x: list[float]
    """Of each point."""

    y: list[float | None]
    """Of each point; None is a gap."""

    style: int = 0
    """A place in STYLES; -1 for what was measured."""

    marks: bool = False
    """Whether its points are marked instead of joined."""


@dataclass(frozen=True)
class Bar:
    """A span of x in one of the TONES."""

    start: float
    """The least x."""

    end: float
    """The greatest x."""

    tone: int
    """A place in TONES."""


@dataclass(frozen=True)
class Lane:
    """Bars in one line."""

    label: str
    """What stands beside them, in one line or more."""

    bars: list[Bar]
    """They may overlap."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    x: str
    """The label with its unit."""

    y: str
    """The label with its unit."""

    curves: list[Curve]
    """All that are drawn."""

    levels: list[tuple[str, float]] = field(default_factory=list[tuple[str, float]])
    """Dashed lines: a label and its y."""

    shaded: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    """Spans of x."""

    log_x: bool = False
    """Whether x is logarithmic."""

    log_y: bool = False
    """Whether y is logarithmic."""

    y_limits: tuple[float, float] | None = None
    """The least and the greatest y that are shown; None for all."""

    categories: list[str] = field(default_factory=list[str])
    """Words along x, which then counts them from 0."""

    lanes: list[Lane] = field(default_factory=list[Lane])
    """Lines of bars, the first on top."""

    bands: list[Bar] = field(default_factory=list[Bar])
    """They lie behind the curves, as high as the panel."""

    map: bool = False
    """Whether x and y have one scale."""

    downward: bool = False
    """Whether y grows down, as in a picture."""


@dataclass(frozen=True)
class Figure:
    """Panels in rows, under one title."""

    title: str
    """Above all panels."""

    panels: list[Panel]
    """Row by row."""

    columns: int = 1
    """Panels in a row."""


def curve(label: str, x: Any, y: Any, style: int = 0, marks: bool = False) -> Curve:
    """A curve of two arrays, thinned to what can be seen and rounded to six digits.

    What is not finite is a gap.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    step = max(1, -(-len(x) // MAX_POINTS))
    rounded = [[float(f"{value:.6g}") for value in values[::step]] for values in (x, y)]
    known = [value if np.isfinite(value) else None for value in rounded[1]]
    return Curve(label, rounded[0], known, style, marks)


def save(figure: Figure, path: Path) -> None:
    """Draw a figure into a PNG file."""
    with whole(path) as part:
        _canvas(figure).savefig(part, format="png", dpi=130)


def svg(figure: Figure) -> str:
    """Draw a figure as SVG, the same text for the same figure."""
    import matplotlib as mpl

    text = io.StringIO()
    with mpl.rc_context(RC):
        _canvas(figure).savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def _canvas(figure: Figure) -> "Canvas":
    """The figure as Matplotlib has it, which is loaded only now: it takes a second."""
    import matplotlib as mpl
    from matplotlib.figure import Figure as Canvas

    heights = _row_heights(figure)
    width = 9.6 if any(panel.lanes or panel.map for panel in figure.panels) else 7.2
    share = figure.columns == 1 and len({panel.x for panel in figure.panels}) == 1
    with mpl.rc_context(RC):
        canvas = Canvas(figsize=(width, 0.7 + sum(heights)), layout="constrained")
        canvas.suptitle(figure.title, fontsize=10)
        axes = canvas.subplots(
            len(heights), figure.columns, squeeze=False, sharex=share, height_ratios=heights
        )
        for i, axis in enumerate(axes.ravel()):
            if i < len(figure.panels):
                lowest = i >= len(figure.panels) - figure.columns
                _draw(figure.panels[i], axis, label_x=lowest or not share)
            else:
                axis.set_axis_off()
    return canvas


def _row_heights(figure: Figure) -> list[float]:
    """Inches of each row of panels: as many as its highest panel needs."""
    rows = -(-len(figure.panels) // figure.columns)
    usual = 1.6 if rows > 1 and figure.columns == 1 else 2.6
    first = range(0, rows * figure.columns, figure.columns)
    return [max(_height(p, usual) for p in figure.panels[i : i + figure.columns]) for i in first]


def _height(panel: Panel, usual: float) -> float:
    """Inches that a panel needs."""
    if panel.lanes:
        return 0.25 + 0.15 * sum(_lines(lane) for lane in panel.lanes)
    return 3.4 if panel.map else 2.6 if panel.bands else usual


def _lines(lane: Lane) -> float:
    """Lines of text that a lane is high: those of its label, and half a one between labels."""
    return 1.5 + lane.label.count("\n")


def _draw(panel: Panel, axis: Any, label_x: bool) -> None:
    """Draw a panel on a pair of axes."""
    for one in panel.curves:
        _draw_curve(one, axis)
    for start, end in panel.shaded:
        axis.axvspan(start, end, color="#e69f00", alpha=0.18, lw=0)
    for band in panel.bands:
        axis.axvspan(band.start, band.end, color=TONES[band.tone], alpha=0.3, lw=0)
    for label, level in panel.levels:
        _draw_level(label, level, axis)
    _draw_scales(panel, axis)
    if label_x:
        axis.set_xlabel(panel.x)
    axis.set_ylabel(panel.y)
    if any(one.label for one in panel.curves):
        axis.legend(fontsize=8)
    _draw_lanes(panel.lanes, axis)


def _draw_curve(one: Curve, axis: Any) -> None:
    style = MEASURED if one.style < 0 else STYLES[one.style % len(STYLES)]
    y = [np.nan if value is None else value for value in one.y]
    marks = {"marker": style.marker, "ms": 4} if one.marks else {}
    dashes = "" if one.marks else style.dashes
    look = {"color": style.colour, "ls": dashes, "lw": style.width, **marks}
    axis.plot(one.x, y, label=one.label or None, **look)


def _draw_level(label: str, level: float, axis: Any) -> None:
    """A dashed line, with its label at its right end."""
    axis.axhline(level, color="#555555", ls=(0, (4, 3)), lw=1)
    place, coordinates = (0.995, level), ("axes fraction", "data")
    axis.annotate(label, place, xycoords=coordinates, ha="right", va="bottom", fontsize=8)


def _draw_scales(panel: Panel, axis: Any) -> None:
    """Logarithmic or linear, how far they reach, and the words along x."""
    axis.set_xscale("log" if panel.log_x else "linear")
    axis.set_yscale("log" if panel.log_y else "linear")
    if panel.y_limits is not None:
        axis.set_ylim(*panel.y_limits)
    if panel.map:
        axis.set_aspect("equal", adjustable="datalim")
    if panel.downward:
        axis.invert_yaxis()
    if panel.categories:
        count, tilt = len(panel.categories), _tilt(panel.categories)
        axis.set_xticks(range(count), panel.categories, rotation=tilt)
        axis.set_xlim(-0.6, count - 0.4)


def _draw_lanes(lanes: Sequence[Lane], axis: Any) -> None:
    """Draw each lane's bars in a line, the first lane on top.

    A short bar is drawn wide enough to be seen.
    """
    if not lanes:
        return
    places: list[float] = []
    depth = 0.0
    for lane in lanes:
        places.append(depth + _lines(lane) / 2.0)
        depth += _lines(lane)
        for bar in lane.bars:
            span, height = (bar.start, bar.end - bar.start), (places[-1] - 0.45, 0.9)
            axis.broken_barh([span], height, color=TONES[bar.tone], lw=1.2)
    axis.set_yticks(places, [lane.label for lane in lanes], fontsize=7.5)
    axis.set_ylim(depth, 0.0)
    axis.tick_params(axis="y", length=0)
    axis.grid(visible=False, axis="y")


def _tilt(words: Sequence[str]) -> float:
    """Degrees by which words along x are turned, so that long ones fit."""
    return 25.0 if max(map(len, words)) * len(words) > 70 else 0.0
