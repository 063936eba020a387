"""Figures as data, and how they are drawn: one style for all, told apart in colour, by colour-blind
eyes and in grey.

A figure is plain numbers and words, so that it can be kept, compared bit for bit and drawn again.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rcmservo.config.files import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

MAX_POINTS = 500
"""Points of a curve beyond which it is thinned: more cannot be seen."""

STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#0072b2", "ls": "-", "lw": 1.5, "marker": "o"},
    {"color": "#d55e00", "ls": "--", "lw": 1.5, "marker": "s"},
    {"color": "#009e73", "ls": "-.", "lw": 1.5, "marker": "^"},
    {"color": "#000000", "ls": ":", "lw": 1.7, "marker": "D"},
    {"color": "#cc79a7", "ls": (0, (5, 1, 1, 1, 1, 1)), "lw": 1.5, "marker": "v"},
    {"color": "#e69f00", "ls": (0, (8, 2)), "lw": 1.5, "marker": "P"},
    {"color": "#56b4e9", "ls": (0, (2, 1)), "lw": 1.5, "marker": "X"},
)
"""Colours after Okabe and Ito; every style has its own dashes and marker too."""

MEASURED: dict[str, Any] = {"color": "#999999", "ls": "-", "lw": 2.6, "marker": "."}
"""The measured curve that an estimate is laid upon."""

TONES = ("#999999", "#d0d0d0", "#56b4e9", "#009e73", "#f0e442", "#e69f00", "#d55e00")
"""Colours of bands and bars, from harmless to grave."""

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
    """A line, or with ``marks`` points. ``style`` is a place in STYLES, -1 that of what was
    measured."""

    label: str
    x: list[float]
    y: list[float | None]
    style: int = 0
    marks: bool = False


@dataclass(frozen=True)
class Bar:
    """A span of x in one of the TONES."""

    start: float
    end: float
    tone: int


@dataclass(frozen=True)
class Lane:
    """Bars in one line, and a label of one line or more beside them."""

    label: str
    bars: list[Bar]


@dataclass(frozen=True)
class Panel:
    """One pair of axes: labels with units, curves, dashed ``levels`` (label, y), ``shaded`` spans
    of x.

    With ``categories``, x counts them from 0. With ``lanes``, the first on top, y counts them.
    ``bands`` lie behind the curves. A ``map`` has one scale for x and y; ``downward``, y grows down
    as in a picture.
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
    """Panels in rows of ``columns``, under one title."""

    title: str
    panels: list[Panel]
    columns: int = 1


def curve(label: str, x: Any, y: Any, style: int = 0, marks: bool = False) -> Curve:
    """A curve of two arrays, thinned to what can be seen and rounded to six digits; what is not
    finite is a gap."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    step = max(1, -(-len(x) // MAX_POINTS))
    rounded = [[float(f"{value:.6g}") for value in values[::step]] for values in (x, y)]
    return Curve(
        label,
        rounded[0],
        [value if np.isfinite(value) else None for value in rounded[1]],
        style,
        marks,
    )


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
    """The figure as Matplotlib draws it, which is loaded only now: it takes a second."""
    import matplotlib as mpl
    from matplotlib.figure import Figure as Canvas

    rows = -(-len(figure.panels) // figure.columns)
    with mpl.rc_context(RC):
        usual = 1.6 if rows > 1 and figure.columns == 1 else 2.6
        lines = [figure.panels[i * figure.columns :][: figure.columns] for i in range(rows)]
        heights = [max(_height(panel, usual) for panel in line) for line in lines]
        wide = any(panel.lanes or panel.map for panel in figure.panels)
        width = 9.6 if wide else 7.2
        canvas = Canvas(figsize=(width, 0.7 + sum(heights)), layout="constrained")
        canvas.suptitle(figure.title, fontsize=10)
        share = figure.columns == 1 and len({panel.x for panel in figure.panels}) == 1
        axes = canvas.subplots(
            rows, figure.columns, squeeze=False, sharex=share, height_ratios=heights
        )
        for i, axis in enumerate(axes.ravel()):
            if i < len(figure.panels):
                lowest = i >= len(figure.panels) - figure.columns
                _draw(figure.panels[i], axis, label_x=lowest or not share)
            else:
                axis.set_axis_off()
    return canvas


def _height(panel: Panel, usual: float) -> float:
    """Inches that a panel needs."""
    if panel.lanes:
        return 0.25 + 0.15 * sum(_lines(lane) for lane in panel.lanes)
    return 3.4 if panel.map else 2.6 if panel.bands else usual


def _lines(lane: Lane) -> float:
    """Lines of text that a lane is high: those of its label, and half a one between labels."""
    return 1.5 + lane.label.count("\n")


def _draw(panel: Panel, axis: Any, label_x: bool) -> None:
    for one in panel.curves:
        style = dict(MEASURED if one.style < 0 else STYLES[one.style % len(STYLES)])
        marker = style.pop("marker")
        y = [np.nan if value is None else value for value in one.y]
        look = {"marker": marker, "ms": 4, **style, "ls": ""} if one.marks else style
        axis.plot(one.x, y, label=one.label or None, **look)
    for start, end in panel.shaded:
        axis.axvspan(start, end, color="#e69f00", alpha=0.18, lw=0)
    for band in panel.bands:
        axis.axvspan(band.start, band.end, color=TONES[band.tone], alpha=0.3, lw=0)
    for label, level in panel.levels:
        axis.axhline(level, color="#555555", ls=(0, (4, 3)), lw=1)
        axis.annotate(
            label,
            (0.995, level),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="bottom",
            fontsize=8,
        )
    axis.set_xscale("log" if panel.log_x else "linear")
    axis.set_yscale("log" if panel.log_y else "linear")
    if panel.y_limits is not None:
        axis.set_ylim(*panel.y_limits)
    if panel.map:
        axis.set_aspect("equal", adjustable="datalim")
    if panel.downward:
        axis.invert_yaxis()
    if panel.categories:
        axis.set_xticks(
            range(len(panel.categories)), panel.categories, rotation=_tilt(panel.categories)
        )
        axis.set_xlim(-0.6, len(panel.categories) - 0.4)
    if label_x:
        axis.set_xlabel(panel.x)
    axis.set_ylabel(panel.y)
    if any(one.label for one in panel.curves):
        axis.legend(fontsize=8)
    _draw_lanes(panel.lanes, axis)


def _draw_lanes(lanes: Sequence[Lane], axis: Any) -> None:
    """Bars in a line each, the first on top; a short one is drawn wide enough to be seen."""
    if not lanes:
        return
    places: list[float] = []
    depth = 0.0
    for lane in lanes:
        places.append(depth + _lines(lane) / 2.0)
        depth += _lines(lane)
        for bar in lane.bars:
            colour = TONES[bar.tone]
            axis.broken_barh(
                [(bar.start, bar.end - bar.start)], (places[-1] - 0.45, 0.9), color=colour, lw=1.2
            )
    axis.set_yticks(places, [lane.label for lane in lanes], fontsize=7.5)
    axis.set_ylim(depth, 0.0)
    axis.tick_params(axis="y", length=0)
    axis.grid(visible=False, axis="y")


def _tilt(words: Sequence[str]) -> float:
    return 25.0 if max(map(len, words)) * len(words) > 70 else 0.0
