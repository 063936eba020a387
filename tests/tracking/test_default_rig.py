"""What the tracker promises at the default rig, in small: benchmarks/tracking.py asks more."""

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
from rcmservo.sim.rig import Rig
from rcmservo.tracking import ColourMarkers, PointMarkers


@pytest.mark.slow
def test_the_error_hardly_changes_with_the_place_on_the_grid_of_pixels() -> None:
    """In scenes 6, 8, 13 and 14 it jumped: the fit to the pixels stood in one picture and not in
    the next."""
    errors = np.array([errors_on_path(seed, length=2.0) for seed in (0, 2, 6, 8, 13, 14)])[..., :2]
    assert rms(np.linalg.norm(errors, axis=-1)) < 0.10
    assert rms(np.array([about_trend(one) for one in errors])) < 0.02


@pytest.mark.slow
def test_the_covariance_that_is_told_explains_the_scatter_over_noise() -> None:
    """In scene 6 the ball was not looked at from where it was, and in one picture of eight no
    covariance was told."""
    told = np.array([surprise(seed, 16) for seed in (0, 1, 3, 4, 6, 13)])
    assert 0.5 < told.mean() < 1.6


def test_the_covariance_is_unknown_where_a_marker_is_lost_or_only_a_point() -> None:
    lost = ColourMarkers().find(Frame(0, 0, 0, np.zeros((60, 80, 3), np.uint8)))
    point = PointMarkers().find(Frame(0, 0, 0, points=np.ones((2, 2))))
    for seen in (lost, point):
        assert seen.covariance.shape == (2, 3, 3)
        assert np.isnan(seen.covariance).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_third_ball_of_a_markers_colour_is_told_and_not_chosen(seed: int) -> None:
    frame = third_ball(seed)
    assert np.isnan(ColourMarkers().find(frame).points).any()
    assert "two pairs of balls can be the markers" in ColourMarkers().why(frame)


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
def test_a_tool_that_gains_speed_is_followed_though_it_is_smeared() -> None:
    """By up to 13.5 px, more than most balls' radius. By sharp outlines alone more than half of
    these are lost or wrong, by the smeared one alone a sixth; what is left is found, 3 to 4 px
    off, and its covariance says so."""
    found = [one for seed in range(10) for one in from_rest(seed, 15.0, 12, 0.015)]
    bad, due = bad_of(found)
    assert due > 100
    assert bad <= 0.08 * due
    off = np.array([seen.points - balls[:, :2] for seen, balls in found])
    told = np.array([seen.covariance[:, 0, 0] for seen, _ in found])
    assert 0.5 < np.nanmean(off**2 / told[:, :, None]) < 1.5


def test_a_ball_of_which_half_is_seen_is_followed_when_it_begins_to_be_smeared() -> None:
    """In scene 306 the shaft hides half of it, and it was lost as soon as no sharp look found
    it."""
    bad, due = bad_of(from_rest(306, 15.0, 12, 1.0 / 60.0))
    assert bad == 0 and due >= 10


def test_a_ball_that_comes_into_the_picture_smeared_is_followed_by_the_way_of_the_other() -> None:
    """Scene 406."""
    bad, due = bad_of(from_rest(406, 15.0, 12, 1.0 / 60.0))
    assert bad == 0 and due >= 10
