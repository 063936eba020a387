"""Charts as data: the same figure gives the same drawing, and gaps stay gaps."""

import json
from dataclasses import asdict
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from rcmservo.errors import UnusableFile
from rcmservo.figures.charts import (
    MAX_POINTS,
    STYLES,
    Figure,
    Panel,
    draw_figure,
    make_curve,
    render_svg,
    save_figure,
)


def example() -> Figure:
    x = np.linspace(0.0, 1.0, 5000)
    y = np.where(x < 0.5, x, np.nan)
    panels = [
        Panel(
            "time [s]",
            "$y$ [px]",
            [make_curve("one", x, y), make_curve("two", x, 1.0 - x, 1, marks=True)],
            [("2 %", 0.02)],
        ),
        Panel(
            "time [s]",
            "$z$ [mm]",
            [make_curve("", x + 0.1, x + 0.1, -1)],
            shaded=[(0.1, 0.2)],
            log_x=True,
            log_y=True,
        ),
    ]
    return Figure("A figure", panels, columns=2)


def test_the_same_figure_gives_the_same_drawing() -> None:
    text = render_svg(example())
    assert text == render_svg(example())
    assert ElementTree.fromstring(text).tag.endswith("svg")
    assert "<image" not in text


def test_a_curve_is_thinned_and_non_finite_values_are_gaps() -> None:
    first_curve = example().panels[0].curves[0]
    assert 100 < len(first_curve.x) <= MAX_POINTS
    assert first_curve.y[0] == 0.0
    assert first_curve.y[-1] is None
    json.dumps(asdict(example()), allow_nan=False)


def test_curves_are_distinguishable_without_colour() -> None:
    assert len({str(style.dashes) for style in STYLES}) == len(STYLES)
    assert len({style.marker for style in STYLES}) == len(STYLES)


def test_a_figure_is_saved_as_png(tmp_path: Path) -> None:
    save_figure(example(), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_a_figure_that_cannot_be_saved_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "figure.png.part").mkdir()
    with pytest.raises(UnusableFile, match=r"figure.png: cannot be written"):
        save_figure(example(), tmp_path / "figure.png")
    assert not (tmp_path / "figure.png").exists()


def test_a_map_has_one_scale_for_both_axes_and_can_grow_downwards() -> None:
    panel = Panel("u [px]", "v [px]", [make_curve("", [0, 400], [0, 100])], map=True, downward=True)
    (axis,) = draw_figure(Figure("", [panel])).axes
    assert axis.get_aspect() == 1.0 and axis.yaxis_inverted()
