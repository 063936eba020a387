"""Tool models: two markers on one axis through the RCM, at a fixed spacing or a fixed ratio."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import draw_tool_positions, make_random, seeds
from rcmservo.errors import BadInput
from rcmservo.geometry.tool import (
    RIGID,
    SCALED,
    RigidTool,
    ScaledTool,
    ToolStruct,
    compute_second_marker,
)

spacings = st.floats(1.0, 100.0)


@given(seeds, spacings)
def test_on_a_rigid_shaft_the_markers_keep_their_spacing_along_the_axis_outwards(seed, spacing):
    p1 = draw_tool_positions(make_random(seed), 1)[0]
    displacement = RigidTool(spacing).second_marker(p1) - p1
    assert np.allclose(displacement, spacing * p1 / np.linalg.norm(p1))


@given(seeds, st.floats(1.01, 5.0))
def test_on_a_scaled_tool_the_markers_keep_their_ratio(seed, scale):
    p1 = draw_tool_positions(make_random(seed), 1)[0]
    assert np.allclose(ScaledTool(scale).second_marker(p1), scale * p1)


@given(seeds, spacings)
def test_both_tools_agree_at_the_insertion_of_their_common_lambda(seed, spacing):
    p1 = draw_tool_positions(make_random(seed), 1)[0]
    scale = 1.0 + spacing / np.linalg.norm(p1)
    assert np.allclose(RigidTool(spacing).second_marker(p1), ScaledTool(scale).second_marker(p1))


def test_insertion_shrinks_the_imaged_distance_of_a_rigid_tool_and_grows_a_scaled_one():
    """A constant λ gives ∂d/∂ρ the opposite sign, for a camera along a tool inclined by 40°."""

    def d(kind, value, rho):
        p1 = rho * np.array([np.sin(0.7), 0.0, np.cos(0.7)])
        pair = np.stack([p1, compute_second_marker(ToolStruct(kind, value), p1)])
        image = 800 * pair[:, :2] / (200 + pair[:, 2:])
        return np.linalg.norm(image[1] - image[0])

    assert d(RIGID, 40.0, 101.0) < d(RIGID, 40.0, 99.0)
    assert d(SCALED, 1.4, 101.0) > d(SCALED, 1.4, 99.0)


@pytest.mark.parametrize("bad", [0.0, -30.0, np.nan, np.inf])
def test_a_spacing_that_is_not_a_positive_length_is_refused(bad):
    with pytest.raises(BadInput, match="spacing"):
        RigidTool(bad)


@pytest.mark.parametrize(("bad", "unit"), [(0.03, "m"), (30_000.0, "µm")])
def test_a_spacing_of_implausible_size_names_its_likely_unit(bad, unit):
    with pytest.raises(BadInput, match=rf"spacing must be .*this looks like {unit}\)"):
        RigidTool(bad)
    for possible in (1.0, 1000.0):
        assert RigidTool(possible).spacing == possible


@pytest.mark.parametrize("bad", [1.0, 0.5, -2.0, np.nan, np.inf])
def test_a_factor_that_puts_marker_2_at_or_before_marker_1_is_refused(bad):
    with pytest.raises(BadInput, match="scale"):
        ScaledTool(bad)


@pytest.mark.parametrize("tool", [RigidTool, ScaledTool])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -67_000.0])
def test_an_offset_that_is_not_finite_or_implausible_is_refused(tool, bad):
    with pytest.raises(BadInput, match="offset must be a number from -1000 to 1000 mm"):
        tool(30.0, offset=bad)
