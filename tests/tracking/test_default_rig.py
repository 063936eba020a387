"""Accuracy of the tracker at the default rig, on a small sample of benchmarks/tracking.py."""

import numpy as np
import pytest
from tracking_measures import (
    about_trend,
    bad_of,
    errors_on_path,
    from_rest,
    lost_or_wrong,
    renderer_of,
    rms,
    surprise,
    third_ball,
)

from rcmservo.interfaces import Frame
from rcmservo.sim import Rig
from rcmservo.tracking import ColourMarkers, PointMarkers


@pytest.mark.slow
def test_the_error_hardly_depends_on_the_position_on_the_pixel_grid() -> None:
    """Regression: in scenes 6, 8, 13 and 14 the error jumped from image to image.

    The edge fit succeeded in one image and failed in the next.
    """
    errors = np.array([errors_on_path(seed, length=2.0) for seed in (6, 8, 13, 14)])[..., :2]
    assert rms(np.linalg.norm(errors, axis=-1)) < 0.10
    assert rms(np.array([about_trend(one) for one in errors])) < 0.02


@pytest.mark.slow
def test_the_reported_covariance_explains_the_scatter_caused_by_noise() -> None:
    """Regression: in scene 6 one image of eight gave no covariance.

    The fit did not start from the ball's last position.
    """
    covariance_ratio = np.array([surprise(seed, 16) for seed in (0, 3, 6, 13)])
    assert 0.5 < covariance_ratio.mean() < 1.6


def test_the_covariance_is_unknown_where_a_marker_is_lost_or_only_a_point() -> None:
    lost = ColourMarkers().find(Frame(0, 0, 0, np.zeros((60, 80, 3), np.uint8)))
    point = PointMarkers().find(Frame(0, 0, 0, points=np.ones((2, 2))))
    for markers in (lost, point):
        assert markers.covariance.shape == (2, 3, 3)
        assert np.isnan(markers.covariance).all()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_third_ball_of_a_markers_colour_is_reported_and_not_chosen(seed: int) -> None:
    """It is similar to marker 2 in the first scene and to marker 1 in the second."""
    frame = third_ball(seed)
    assert np.isnan(ColourMarkers().find(frame).points).any()
    assert "two pairs of balls can be the markers" in ColourMarkers().explain_failure(frame)


def test_a_third_ball_changes_nothing_for_markers_that_are_followed() -> None:
    rig, tracker = Rig(1), ColourMarkers()
    alone = renderer_of(rig).render(rig.body.points(rig.scene.target)[None], 0)
    first = tracker.find(Frame(0, 0, 0, alone)).points
    assert np.abs(tracker.find(third_ball(1)).points - first).max() < 0.5


def test_a_tool_that_moves_by_fifteen_pixels_a_frame_is_followed() -> None:
    bad, due = np.sum([lost_or_wrong(seed, 15.0, 16) for seed in (0, 1)], axis=0)
    assert due > 20
    assert bad <= 0.02 * due


@pytest.mark.slow
def test_an_accelerating_tool_is_followed_despite_motion_blur() -> None:
    """The blur reaches 13.5 px, more than the radius of most balls.

    Sharp outlines alone lose or misplace more than half of these markers, blurred outlines alone a
    sixth. The remaining errors of 3 to 4 px agree with the reported covariance.
    """
    found = [one for seed in range(6) for one in from_rest(seed, 15.0, 12, 0.015)]
    bad, due = bad_of(found)
    assert due > 60
    assert bad <= 0.08 * due
    error = np.array([markers.points - balls[:, :2] for markers, balls in found])
    variance = np.array([markers.covariance[:, 0, 0] for markers, _ in found])
    assert 0.5 < np.nanmean(error**2 / variance[:, :, None]) < 1.5


def test_a_half_visible_ball_is_followed_when_motion_blur_begins() -> None:
    """Regression: in scene 306 the tracker lost the ball as soon as the sharp fit failed."""
    bad, due = bad_of(from_rest(306, 15.0, 12, 1.0 / 60.0))
    assert bad == 0 and due >= 10


def test_a_ball_that_enters_the_image_blurred_is_followed_by_the_motion_of_the_other() -> None:
    """Regression: scene 406."""
    bad, due = bad_of(from_rest(406, 15.0, 12, 1.0 / 60.0))
    assert bad == 0 and due >= 10
