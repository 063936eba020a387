"""Figures as data: the same figure gives the same drawing, and nothing is drawn that was not
there."""

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
    _canvas,
    curve,
    save,
    svg,
)


def example() -> Figure:
    x = np.linspace(0.0, 1.0, 5000)
    y = np.where(x < 0.5, x, np.nan)
    panels = [
        Panel(
            "time [s]",
            "$y$ [px]",
            [curve("one", x, y), curve("two", x, 1.0 - x, 1, marks=True)],
            [("2 %", 0.02)],
        ),
        Panel(
            "time [s]",
            "$z$ [mm]",
            [curve("", x + 0.1, x + 0.1, -1)],
            shaded=[(0.1, 0.2)],
            log_x=True,
            log_y=True,
        ),
    ]
    return Figure("A figure", panels, columns=2)


def test_the_same_figure_gives_the_same_drawing() -> None:
    text = svg(example())
    assert text == svg(example())
    assert ElementTree.fromstring(text).tag.endswith("svg")
    assert "<image" not in text


def test_a_curve_is_thinned_and_what_is_not_finite_is_a_gap() -> None:
    one = example().panels[0].curves[0]
    assert 100 < len(one.x) <= MAX_POINTS
    assert one.y[0] == 0.0
    assert one.y[-1] is None
    json.dumps(asdict(example()), allow_nan=False)


def test_curves_can_be_told_apart_without_colour() -> None:
    assert len({str(style.dashes) for style in STYLES}) == len(STYLES)
    assert len({style.marker for style in STYLES}) == len(STYLES)


def test_a_figure_can_be_saved_as_a_picture(tmp_path: Path) -> None:
    save(example(), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_a_figure_that_cannot_be_saved_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "figure.png.part").mkdir()
    with pytest.raises(UnusableFile, match=r"figure.png: cannot be written"):
        save(example(), tmp_path / "figure.png")
    assert not (tmp_path / "figure.png").exists()


def test_a_map_has_one_scale_for_both_axes_and_a_picture_grows_downwards() -> None:
    panel = Panel("u [px]", "v [px]", [curve("", [0, 400], [0, 100])], map=True, downward=True)
    (axis,) = _canvas(Figure("", [panel])).axes
    assert axis.get_aspect() == 1.0 and axis.yaxis_inverted()
