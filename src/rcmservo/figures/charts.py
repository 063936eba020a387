"""Charts as data, and their drawing with Matplotlib in one style.

A figure holds plain numbers and words, so that it can be stored, compared bit for bit and drawn
later. The style is legible for colour-blind readers and without colour.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rcmservo.config.atomic_files import atomic_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

MAX_POINTS = 500
"""Largest number of points of a curve. Longer curves are thinned: a chart resolves no more."""

MAX_PLAIN_RATIO = 300.0
"""Largest ratio of the ends of a logarithmic axis whose labels are plain numbers."""

Dashes = str | tuple[int, tuple[int, ...]]
"""Dash pattern of a line, as Matplotlib takes it."""


class Style(NamedTuple):
    """Style of a curve.

    Parameters
    ----------
    colour : str
        Colour, as a hexadecimal RGB code.
    dashes : Dashes
        Dash pattern of the line.
    width : float
        Width of the line in points.
    marker : str
        Marker at the points of a curve without a line.
    """

    colour: str
    dashes: Dashes
    width: float
    marker: str


STYLES = (
    Style("#0072b2", "-", 1.5, "o"),
    Style("#d55e00", "--", 1.5, "s"),
    Style("#009e73", "-.", 1.5, "^"),
    Style("#000000", ":", 1.7, "D"),
    Style("#cc79a7", (0, (5, 1, 1, 1, 1, 1)), 1.5, "v"),
    Style("#e69f00", (0, (8, 2)), 1.5, "P"),
    Style("#56b4e9", (0, (2, 1)), 1.5, "X"),
)
"""Styles of curves, with the colours of Okabe and Ito. Dashes and markers differ as well."""

MEASURED = Style("#999999", "-", 2.6, ".")
"""Style of a measured curve, under an estimated one."""

TONES = ("#999999", "#d0d0d0", "#56b4e9", "#009e73", "#f0e442", "#e69f00", "#d55e00", "#cc79a7")
"""Colours of bands and bars, from harmless to severe; the last one marks manual motion."""

MATPLOTLIB_SETTINGS: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.framealpha": 0.85,
    "svg.hashsalt": "rcmservo",
}
"""Settings of Matplotlib. The fixed salt makes equal figures give equal SVG text."""


@dataclass(frozen=True)
class Curve:
    """Line or points.

    Parameters
    ----------
    label : str
        Entry in the legend; empty for no entry.
    x : list[float]
        x of each point.
    y : list[float or None]
        y of each point; None is a gap.
    style : int
        Index in `STYLES`; -1 selects `MEASURED`.
    marks : bool
        True for markers at the points instead of a line.
    """

    label: str
    x: list[float]
    y: list[float | None]
    style: int = 0
    marks: bool = False


@dataclass(frozen=True)
class Bar:
    """Span of x in one of the `TONES`.

    Parameters
    ----------
    start : float
        Smallest x.
    end : float
        Largest x.
    tone : int
        Index in `TONES`.
    """

    start: float
    end: float
    tone: int


@dataclass(frozen=True)
class Lane:
    """Row of bars.

    Parameters
    ----------
    label : str
        Label next to the row, of one or more lines.
    bars : list[Bar]
        Bars, which may overlap.
    """

    label: str
    bars: list[Bar]


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Parameters
    ----------
    x : str
        Label of the x axis, with its unit.
    y : str
        Label of the y axis, with its unit.
    curves : list[Curve]
        Curves of the panel.
    levels : list[tuple[str, float]]
        Dashed horizontal lines, each with a label and its y.
    shaded : list[tuple[float, float]]
        Shaded spans of x.
    log_x : bool
        True for a logarithmic x axis.
    log_y : bool
        True for a logarithmic y axis.
    y_limits : tuple[float, float] or None
        Smallest and largest visible y; None for all.
    categories : list[str]
        Words along x; x then counts them from 0.
    lanes : list[Lane]
        Rows of bars, the first on top.
    bands : list[Bar]
        Bars behind the curves, over the full height of the panel.
    map : bool
        True for the same scale of x and y.
    downward : bool
        True for y that grows downwards, as in an image.
    """

    x: str
    y: str
    curves: list[Curve]
    levels: list[tuple[str, float]] = field(default_factory=list[tuple[str, float]])
    shaded: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    log_x: bool = False
    log_y: bool = False
    y_limits: tuple[float, float] | None = None
    categories: list[str] = field(default_factory=list[str])
    lanes: list[Lane] = field(default_factory=list[Lane])
    bands: list[Bar] = field(default_factory=list[Bar])
    map: bool = False
    downward: bool = False


@dataclass(frozen=True)
class Figure:
    """Panels in rows under one title.

    Parameters
    ----------
    title : str
        Title above all panels.
    panels : list[Panel]
        Panels, row by row.
    columns : int
        Panels per row.
    """

    title: str
    panels: list[Panel]
    columns: int = 1


def make_curve(label: str, x: Any, y: Any, style: int = 0, marks: bool = False) -> Curve:
    """Return a curve of two arrays, thinned to `MAX_POINTS` and rounded to six digits.

    A value that is not finite becomes a gap.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    step = max(1, -(-len(x) // MAX_POINTS))
    rounded = [[float(f"{value:.6g}") for value in values[::step]] for values in (x, y)]
    y_or_gaps = [value if np.isfinite(value) else None for value in rounded[1]]
    return Curve(label, rounded[0], y_or_gaps, style, marks)


def save_figure(figure: Figure, path: Path) -> None:
    """Draw a figure into a PNG file."""
    with atomic_path(path) as partial_file:
        draw_figure(figure).savefig(partial_file, format="png", dpi=130)


def render_svg(figure: Figure) -> str:
    """Return a figure as SVG; the same figure gives the same text."""
    import matplotlib as mpl

    text = io.StringIO()
    with mpl.rc_context(MATPLOTLIB_SETTINGS):
        draw_figure(figure).savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def draw_figure(figure: Figure) -> "Canvas":
    """Return a figure as a Matplotlib figure, which its caller may change and save.

    The import of Matplotlib takes a second and is therefore local.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure as Canvas

    heights = _compute_row_heights(figure)
    width = 9.6 if any(panel.lanes or panel.map for panel in figure.panels) else 7.2
    share_x = figure.columns == 1 and len({panel.x for panel in figure.panels}) == 1
    with mpl.rc_context(MATPLOTLIB_SETTINGS):
        canvas = Canvas(figsize=(width, 0.7 + sum(heights)), layout="constrained")
        canvas.suptitle(figure.title, fontsize=10)
        axes = canvas.subplots(
            len(heights), figure.columns, squeeze=False, sharex=share_x, height_ratios=heights
        )
        for i, axis in enumerate(axes.ravel()):
            if i < len(figure.panels):
                is_lowest = i >= len(figure.panels) - figure.columns
                _draw_panel(figure.panels[i], axis, has_x_label=is_lowest or not share_x)
            else:
                axis.set_axis_off()
    return canvas


def _compute_row_heights(figure: Figure) -> list[float]:
    """Return the height of each row of panels (inches): that of its tallest panel."""
    panels, columns = figure.panels, figure.columns
    usual = 1.6 if columns == 1 and len(panels) > 1 else 2.6
    rows = (panels[i : i + columns] for i in range(0, len(panels), columns))
    return [max(_compute_height(panel, usual) for panel in row) for row in rows]


def _compute_height(panel: Panel, usual: float) -> float:
    """Return the height of a panel (inches); `usual` is that of a panel of curves."""
    if panel.lanes:
        return 0.25 + 0.15 * sum(_count_lines(lane) for lane in panel.lanes)
    return 3.4 if panel.map else 2.6 if panel.bands else usual


def _count_lines(lane: Lane) -> float:
    """Return the height of a lane in lines of text: its label and half a line of space."""
    return 1.5 + lane.label.count("\n")


def _draw_panel(panel: Panel, axis: Any, has_x_label: bool) -> None:
    for curve in panel.curves:
        _draw_curve(curve, axis)
    for start, end in panel.shaded:
        axis.axvspan(start, end, color="#e69f00", alpha=0.18, lw=0)
    for band in panel.bands:
        axis.axvspan(band.start, band.end, color=TONES[band.tone], alpha=0.3, lw=0)
    for label, level in panel.levels:
        _draw_level(label, level, axis)
    _draw_scales(panel, axis)
    if has_x_label:
        axis.set_xlabel(panel.x)
    axis.set_ylabel(panel.y)
    if any(curve.label for curve in panel.curves):
        axis.legend(fontsize=8)
    _draw_lanes(panel.lanes, axis)


def _draw_curve(curve: Curve, axis: Any) -> None:
    style = MEASURED if curve.style < 0 else STYLES[curve.style % len(STYLES)]
    y = [np.nan if value is None else value for value in curve.y]
    line = {"marker": style.marker, "ms": 4, "ls": ""} if curve.marks else {"ls": style.dashes}
    axis.plot(curve.x, y, label=curve.label or None, color=style.colour, lw=style.width, **line)


def _draw_level(label: str, level: float, axis: Any) -> None:
    """Draw a dashed line with its label at the right end."""
    axis.axhline(level, color="#555555", ls=(0, (4, 3)), lw=1)
    position, coordinates = (0.995, level), ("axes fraction", "data")
    axis.annotate(label, position, xycoords=coordinates, ha="right", va="bottom", fontsize=8)


def _draw_scales(panel: Panel, axis: Any) -> None:
    """Set the scales, the limits and the words along x."""
    axis.set_xscale("log" if panel.log_x else "linear")
    axis.set_yscale("log" if panel.log_y else "linear")
    if panel.log_x:
        _label_few_values(axis)
    if panel.y_limits is not None:
        axis.set_ylim(*panel.y_limits)
    if panel.map:
        axis.set_aspect("equal", adjustable="datalim")
    if panel.downward:
        axis.invert_yaxis()
    if panel.categories:
        count, rotation = len(panel.categories), _choose_rotation(panel.categories)
        axis.set_xticks(range(count), panel.categories, rotation=rotation)
        axis.set_xlim(-0.6, count - 0.4)


def _label_few_values(axis: Any) -> None:
    """Label 1, 2 and 5 in each decade of a short logarithmic x axis as plain numbers.

    Matplotlib would label every number of a decade, and the labels would overlap.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axis.get_xlim()
    axis.xaxis.set_minor_formatter(NullFormatter())
    if high < MAX_PLAIN_RATIO * low:
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter("{x:g}")


def _draw_lanes(lanes: Sequence[Lane], axis: Any) -> None:
    """Draw the bars of each lane in a row, the first lane on top.

    The line width keeps short bars visible.
    """
    if not lanes:
        return
    centres: list[float] = []
    total_height = 0.0
    for lane in lanes:
        centres.append(total_height + _count_lines(lane) / 2.0)
        total_height += _count_lines(lane)
        for bar in lane.bars:
            x_span, y_span = (bar.start, bar.end - bar.start), (centres[-1] - 0.45, 0.9)
            axis.broken_barh([x_span], y_span, color=TONES[bar.tone], lw=1.2)
    axis.set_yticks(centres, [lane.label for lane in lanes], fontsize=7.5)
    axis.set_ylim(total_height, 0.0)
    axis.tick_params(axis="y", length=0)
    axis.grid(visible=False, axis="y")


def _choose_rotation(words: Sequence[str]) -> float:
    """Return the rotation (degrees) of words along x that lets long ones fit."""
    return 25.0 if max(map(len, words)) * len(words) > 70 else 0.0
