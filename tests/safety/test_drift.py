"""Markers that are not where the joints put them: in one frame, lately, or as they stand still."""

import numpy as np
import pytest

from conftest import (
    SHAFT,
    SPACING,
    markers_seen,
    random_from,
    seen_by,
    tick_facts,
    tool_positions,
    true_camera,
)
from rcmservo.control.exploration import Exploring
from rcmservo.estimation.projection_fit import blank, see
from rcmservo.estimation.projection_prediction import expected
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import as_row
from rcmservo.safety.causes import Cause
from rcmservo.safety.checks.drift import one_marker_deviates, watch_drift, watch_stuck
from rcmservo.safety.innovation import misplaced, squared
from rcmservo.safety.monitor_state import Watch, begin
from rcmservo.safety.thresholds import Thresholds

RATE = 60.0
"""Frames a second."""

LIMITS = as_row(Thresholds())[0]
NOISES = pytest.mark.parametrize("noise", [0.1, 0.3, 1.0])
BOTH, NOTHING = np.ones((2, 2)), np.zeros((2, 2))
ONE, OTHER = np.array([[1.0, 1.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 1.0]])


class Watched:
    """A servo's camera, its fit of two seconds, and what watches both; marker 1 goes about within
    ±8 mm.
    """

    def __init__(self, noise: float, seed: int = 0) -> None:
        self.random, self.noise = random_from(seed), noise
        self.places = tool_positions(self.random, 120, 8.0)
        self.middle = self.places.mean(axis=0)
        self.C, self.fit, self.watch = true_camera(self.random, self.places), blank(), begin()
        for p1 in self.places:
            see(self.fit.rows[0], p1, self.seen(p1), SHAFT)
        self.last = self.seen(self.middle)

    def seen(self, p1: Floats) -> Floats:
        return markers_seen(self.C, p1) + self.noise * self.random.standard_normal((2, 2))

    def tells(self, p1: Floats, points: Floats) -> Cause | None:
        """What another frame tells, which is believed."""
        watch_drift(self.watch.rows[0], self.fit.rows[0], p1, points, points, SHAFT, LIMITS)
        facts = tick_facts(watch=self.watch, tour=Exploring.of(done=True), thresholds=LIMITS)
        told = Cause.DRIFTS, Cause.FROZEN
        causes = [cause for cause in told if cause.declared.detector(facts)]
        causes += [Cause.SURPRISED] if one_marker_deviates(facts) else []
        assert len(causes) <= 1
        return causes[0] if causes else None

    def misplaced(self, p1: Floats, points: Floats) -> tuple[bool, bool, bool]:
        return misplaced(self.fit.rows[0], p1, points, self.last, SHAFT, LIMITS)

    def way(self, seconds: float) -> Floats:
        """p₁ (n, 3) mm of a tool that goes back and forth, and further than it was before."""
        time = np.arange(seconds * RATE) / RATE
        shares = np.stack([np.sin(0.7 * time), np.sin(1.1 * time), np.sin(1.3 * time)], axis=1)
        return self.middle + 12.0 * shares


@NOISES
def test_noise_alone_never_drifts_and_its_frames_are_believed(noise: float) -> None:
    for seed in range(4):
        watched = Watched(noise, seed)
        for p1 in watched.way(20.0):
            points = watched.seen(p1)
            assert watched.misplaced(p1, points) == (False, False, False)
            assert watched.tells(p1, points) is None
            watched.last = points


def first_told(watched: Watched, speed: Floats) -> tuple[float, Cause | None]:
    """When markers that slide at `speed` (2, 2) px/s are told, s, and as what; those of a tool that
    moved for a second before.
    """
    for p1 in watched.way(1.0):
        watched.tells(p1, watched.seen(p1))
    for k, p1 in enumerate(watched.way(3.0)):
        cause = watched.tells(p1, watched.seen(p1) + speed * k / RATE)
        if cause is not None:
            return k / RATE, cause
    return np.inf, None


@pytest.mark.parametrize("speed", [4.0, -8.0])
@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_a_camera_that_pans_at_some_pixels_a_second_is_told_within_one(
    speed: float, noise: float
) -> None:
    when, cause = first_told(Watched(noise), speed * BOTH)
    assert when < 1.0 and cause is Cause.DRIFTS


@pytest.mark.parametrize("sliding", [ONE, OTHER])
def test_one_marker_that_slides_alone_is_told_to_be_something_else(sliding: Floats) -> None:
    when, cause = first_told(Watched(0.3), 6.0 * sliding)
    assert when < 1.0 and cause is Cause.SURPRISED


def test_one_frame_counts_in_the_mean_only_so_far_however_wrong_it_is() -> None:
    """Fewer frames than are rejected for good cannot make a drift of it."""
    watched = Watched(0.1)
    for p1 in watched.way(1.0):
        watched.tells(p1, watched.seen(p1))
    before = watched.watch.left.copy()
    for _ in range(Thresholds.rejected):
        assert watched.tells(watched.middle, watched.seen(watched.middle) + 300.0) is None
    moved = np.linalg.norm(watched.watch.left - before, axis=1)
    assert (moved > 0.1).all() and (moved < Thresholds.drift_px).all()


def test_nothing_is_told_before_there_are_enough_frames_to_average() -> None:
    watched = Watched(0.1)
    for k, p1 in enumerate(watched.way(1.0), start=1):
        cause = watched.tells(p1, watched.seen(p1) + 30.0)
        assert (cause is Cause.DRIFTS) == (k >= Thresholds.drift_frames)


def moved(watched: Watched, pixels: float) -> Floats:
    """p₁ (3,) mm where the fit has the markers some px from those at the middle."""
    away, row = np.array([1.0, 0.0, 0.0]), watched.fit.rows[0]
    at = expected(row, watched.middle, SHAFT)
    a_mm = np.abs(expected(row, watched.middle + away, SHAFT) - at).max()
    return watched.middle + away * pixels / a_mm


@pytest.mark.parametrize("pixels,cause", [(0.0, None), (0.5, None), (2.0, Cause.FROZEN)])
def test_the_very_same_picture_of_a_tool_that_moves_is_frozen_and_of_one_at_rest_is_not(
    pixels: float, cause: Cause | None
) -> None:
    watched = Watched(0.1)
    points, there = watched.seen(watched.middle), moved(watched, pixels)
    assert watched.tells(watched.middle, points) is None
    for _ in range(3):
        assert watched.tells(there, points.copy()) is cause
    other = points + np.array([[0.0, 0.0], [0.0, 1e-9]])
    assert watched.tells(there, other) is None, "no camera delivers the same twice"


def hardly_seen(watched: Watched, way: float) -> Floats:
    """p₁ (3,) mm so far from the middle, in the direction in which the markers move least."""
    row, at, steps = watched.fit.rows[0], watched.middle, 0.5 * np.eye(3)
    changes = [expected(row, at + s, SHAFT) - expected(row, at - s, SHAFT) for s in steps]
    return at + way * np.linalg.svd(np.stack([c.ravel() for c in changes], axis=1))[2][-1]


@pytest.mark.parametrize("share,cause", [(0.9, None), (1.1, Cause.FROZEN)])
def test_the_very_same_picture_is_frozen_also_where_the_tool_hardly_moves_in_it(
    share: float, cause: Cause | None
) -> None:
    watched = Watched(0.1)
    points, there = watched.seen(watched.middle), hardly_seen(watched, share * Thresholds.stuck)
    row = watched.fit.rows[0]
    less = np.abs(expected(row, there, SHAFT) - expected(row, watched.middle, SHAFT)).max()
    assert less < 0.5 * Thresholds.drift_px
    assert watched.tells(watched.middle, points) is None
    assert watched.tells(there, points.copy()) is cause


@NOISES
def test_a_frame_with_a_marker_that_is_elsewhere_is_told_and_by_which(noise: float) -> None:
    watched = Watched(noise)
    p1, least = watched.middle, Thresholds.model_error + 9.0 * noise
    for off, wanted in ((ONE, (True, False)), (OTHER, (False, True)), (BOTH, (True, True))):
        points = markers_seen(watched.C, p1)
        watched.last = points
        assert watched.misplaced(p1, points + least * off)[:2] == wanted
        assert watched.misplaced(p1, points)[:2] == (False, False)


def test_markers_that_changed_places_are_told_as_that_and_far_ones_are_not() -> None:
    watched = Watched(0.3)
    points = watched.seen(watched.middle)
    watched.last = points
    assert watched.misplaced(watched.middle, points[::-1].copy()) == (True, True, True)
    assert watched.misplaced(watched.middle, points + 99.0) == (True, True, False)


def test_a_marker_may_be_off_by_a_share_of_its_motion_since_the_frame_before() -> None:
    """The joints at the exposure may be wrong by a little of the time between two frames."""
    watched = Watched(0.1)
    p1, points = watched.middle, markers_seen(watched.C, watched.middle)
    wrong = points + np.array([4.0, 0.0])
    for way, told in ((0.0, True), (40.0, False)):
        watched.last = points + np.array([way, 0.0])
        assert watched.misplaced(p1, wrong)[:2] == (told, told)


@pytest.mark.parametrize("k", [0, 1])
def test_nan_is_misplaced_whatever_it_stands_in(k: int) -> None:
    watched = Watched(0.3)
    p1, points = watched.middle, watched.seen(watched.middle)
    watched.last, hole = points, points.copy()
    hole[k] = np.nan
    assert watched.misplaced(p1, hole)[k]
    assert watched.misplaced(np.full(3, np.nan), points)[:2] == (True, True)
    watched.fit.rows["A"] = np.nan
    assert watched.misplaced(p1, points)[:2] == (True, True)


@pytest.mark.parametrize("part", ["A", "S_inverse", "noise"])
def test_a_fit_that_is_not_finite_is_never_taken_for_one_that_agrees(part: str) -> None:
    """Its frames are not believed: `misplaced` tells before anything is averaged."""
    watched = Watched(0.3)
    points = watched.seen(watched.middle) + 9.0
    watched.last = points
    watched.fit.rows[part] = np.nan
    assert watched.misplaced(watched.middle, points)[:2] == (True, True)


def test_the_square_of_an_error_by_its_covariance_is_that_of_the_books() -> None:
    random = random_from(0)
    for _ in range(20):
        root, x = random.standard_normal((2, 2)), random.standard_normal(2)
        cov = root @ root.T
        wanted = x @ np.linalg.solve(cov + 0.1 * np.eye(2), x)
        found = squared(x[0], x[1], (cov[0, 0], cov[0, 1], cov[1, 1]), 0.1)
        assert found == pytest.approx(wanted)


def test_the_watched_camera_sees_the_tool_as_the_other_tests_do() -> None:
    watched = Watched(0.0)
    p1 = watched.middle
    tip = p1 * (1.0 + SPACING / np.linalg.norm(p1))
    np.testing.assert_allclose(watched.seen(p1), seen_by(watched.C, np.stack([p1, tip])))
    np.testing.assert_allclose(expected(watched.fit.rows[0], p1, SHAFT), watched.seen(p1), atol=0.5)
    assert isinstance(watched.watch, Watch)


def stuck(points: Floats, places: Floats) -> tuple[bool, bool, bool]:
    """Whether marker 1, marker 2 was ever told to stand still while the other did not, and the
    picture to be frozen: `points` (n, 2, 2) px, seen with marker 1 at `places` (n, 3) mm.
    """
    watch, told = begin().rows, np.zeros(3, bool)
    for p1, seen in zip(places, points, strict=True):
        first, second = watch_stuck(watch[0], p1, seen, LIMITS)
        told |= [first, second, Watch(watch).frozen]
    return bool(told[0]), bool(told[1]), bool(told[2])


def explored(seed: int) -> tuple[Floats, Floats]:
    """Places (n, 3) mm of a first motion of 10 mm back and forth, and what a camera with noise sees
    of it.
    """
    watched = Watched(0.3, seed)
    places = watched.way(1.5)
    return places, np.stack([watched.seen(p1) for p1 in places])


@pytest.mark.parametrize("k", [0, 1])
def test_a_marker_that_stands_still_while_the_other_goes_is_told_before_anything_is_foretold(
    k: int,
) -> None:
    for seed in range(20):
        places, points = explored(seed)
        assert stuck(points, places) == (False, False, False)
        noise = points[:, k] - points[:, k].mean(axis=0)
        points[:, k] = points[0, k] + 0.3 * noise / noise.std()
        assert stuck(points, places) == (k == 0, k == 1, False)


def test_a_picture_that_is_frozen_before_anything_is_foretold_is_told_as_that() -> None:
    places, points = explored(0)
    points[20:] = points[20]
    assert stuck(points, places) == (False, False, True)
    still = np.repeat(places[:1], len(places), axis=0)
    assert stuck(points, still) == (False, False, False)
