"""What the camera should see: a projection and a covariance that can be believed, from noisy frames
too.
"""

import numpy as np
import pytest
from hypothesis import given

from conftest import (
    SHAFT,
    SPACING,
    derivative,
    frozen,
    markers_seen,
    random_from,
    seeds,
    seen_by,
    tool_positions,
    true_camera,
)
from rcmservo.estimation.projection_fit import (
    MIN_FRAME_SPACING_MM,
    PRIOR_NOISE_FRAMES,
    RCM_POSITION_MM,
    Prospect,
    blank,
    empty,
    project_point,
    see,
)
from rcmservo.estimation.projection_prediction import (
    both_motions,
    expected,
    features_motion,
    imaged,
    located,
    pose_deviation,
    write_point_jacobian,
)
from rcmservo.geometry.features import about, features
from rcmservo.geometry.tool import second_marker
from rcmservo.interfaces import Floats

LIKELY = 5.991
"""What xᵀ cov⁻¹ x of two coordinates exceeds once in twenty times."""

FAR = np.array([-1.0, 1.0, 60.0])
"""mm: somewhere that no frame of a narrow cloud is near."""


def tips(places: Floats) -> Floats:
    """p₂ (n, 3) mm of p₁ (n, 3)."""
    return places * (1.0 + SPACING / np.linalg.norm(places, axis=1))[:, None]


def pictures(C: Floats, places: Floats) -> Floats:
    """Raw pixels (n, 2, 2) of both markers."""
    return np.stack([seen_by(C, places), seen_by(C, tips(places))], axis=1)


def model(places: Floats, points: Floats) -> Prospect:
    known = blank()
    row = known.rows[0]
    for p1, shown in zip(places, points, strict=True):
        see(row, p1, shown, SHAFT)
    return known


class Scene:
    """A camera, and a tool that was at `frames` places within ±`spread` mm."""

    def __init__(self, seed: int, frames: int, spread: float = 6.0) -> None:
        self.random = random_from(seed)
        self.places = tool_positions(self.random, frames, spread)
        self.middle = self.places.mean(axis=0)
        self.C = true_camera(self.random, self.places[:20])

    def seen(self, noise: float) -> Floats:
        exact = pictures(self.C, self.places)
        return exact + noise * self.random.standard_normal(exact.shape)

    def model(self, noise: float) -> Prospect:
        return model(self.places, self.seen(noise))


def off(known: Prospect, C: Floats, p: Floats) -> tuple[Floats, float]:
    """By how much the fit has the picture of p wrong, (2,) px, and its square by the covariance."""
    place, covariance = imaged(known.rows[0], p)
    wrong = place - seen_by(C, p[None])[0]
    return wrong, float(wrong @ np.linalg.solve(covariance, wrong))


def made_up(seed: int) -> tuple[Prospect, Floats]:
    """Any projection, and a place p₁ before its camera."""
    random = random_from(seed)
    p1 = tool_positions(random, 1)[0]
    known = Prospect.of(
        A=100.0 * random.standard_normal((2, 4)),
        g=random.uniform(-0.2, 0.2, 3),
        origin=[*(p1 + random.uniform(-20.0, 20.0, 3)), 300.0, 200.0],
        offset=random.standard_normal((2, 2)),
    )
    return known, p1


@given(seeds)
def test_the_motion_is_the_derivative_of_what_is_expected(seed: int) -> None:
    known, p1 = made_up(seed)
    row = known.rows[0]
    wanted = derivative(lambda p: imaged(row, p)[0], p1, 1e-2)
    found = np.empty((2, 3))
    write_point_jacobian(row, project_point(row, p1), found)
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-8)
    wanted = derivative(lambda p: expected(row, p, SHAFT).ravel(), p1, 1e-2)
    np.testing.assert_allclose(both_motions(row, p1, SHAFT), wanted, rtol=1e-6, atol=1e-8)


@given(seeds)
def test_the_motion_of_the_features_is_the_derivative_of_the_features(seed: int) -> None:
    known, p1 = made_up(seed)
    row, o_c = known.rows[0], random_from(seed).uniform(-900.0, -300.0, 2)
    points = expected(row, p1, SHAFT)
    wanted = derivative(lambda p: features(about(expected(row, p, SHAFT), o_c)), p1, 1e-3)
    J = features_motion(row, p1, points, o_c, SHAFT)
    np.testing.assert_allclose(J, wanted, rtol=1e-4, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_the_predicted_covariance_is_honest_near_the_frames_and_away_from_them(
    noise: float,
) -> None:
    near, away = [], []
    for seed in range(100):
        scene = Scene(seed, 60)
        known = scene.model(noise)
        for p1 in scene.places[:2]:
            far = scene.middle + 3.0 * (p1 - scene.middle)
            for squares, place in ((near, p1), (away, far)):
                squares += [off(known, scene.C, p)[1] for p in (place, second_marker(SHAFT, place))]
    for squares in (near, away):
        assert 0.90 < np.mean(np.array(squares) < LIKELY) < 0.99


@pytest.mark.parametrize("noise", [0.1, 0.3, 1.0])
def test_the_noise_is_told_once_there_are_many_more_frames_than_what_is_expected_counts_for(
    noise: float,
) -> None:
    frames = round(200 * PRIOR_NOISE_FRAMES)
    told = [Scene(seed, frames).model(noise).noise for seed in range(10)]
    assert np.mean(told) == pytest.approx(noise**2, rel=0.15)


def biased(scenes: int, frames: int, spread: float) -> tuple[Floats, Floats]:
    """By which share of its distance the imaged RCM is too far away in every scene at 0.3 px of
    noise, and the squares of what it is off by the covariance.
    """
    shares, squares = [], []
    for seed in range(scenes):
        scene = Scene(seed, frames, spread)
        wrong, squared = off(scene.model(0.3), scene.C, RCM_POSITION_MM)
        shares.append(share(scene, wrong))
        squares.append(squared)
    return np.array(shares), np.array(squares)


def share(scene: Scene, wrong: Floats) -> float:
    """The part of an error (2,) px along the way from the tool to the imaged RCM, by its length."""
    way = seen_by(scene.C, RCM_POSITION_MM[None])[0] - seen_by(scene.C, scene.middle[None])[0]
    return float(wrong @ way / (way @ way))


@pytest.mark.parametrize(
    "scenes,frames", [(150, 300), pytest.param(200, 5_000, marks=pytest.mark.slow)]
)
def test_the_imaged_rcm_is_not_biased_and_its_covariance_covers_its_error(
    scenes: int, frames: int
) -> None:
    """A cloud of ±6 mm is what ±3° make of a tool that is 115 mm deep."""
    shares, squares = biased(scenes, frames, 6.0)
    assert abs(np.mean(shares)) < 0.01
    assert 0.90 < np.mean(squares < LIKELY) < 0.99


def plain(places: Floats, points: Floats) -> Floats:
    """The imaged RCM (2,) px of the same equations by least squares alone."""
    middle, m_0 = places.mean(axis=0), points.mean(axis=(0, 1))
    both = np.concatenate([places, tips(places)])
    x = np.column_stack([(both - middle) / 100.0, np.ones(len(both))])
    m, none = points.transpose(1, 0, 2).reshape(-1, 2) - m_0, np.zeros_like(x)
    rows = [
        np.column_stack([x, none, -m[:, :1] * x[:, :3]]),
        np.column_stack([none, x, -m[:, 1:] * x[:, :3]]),
    ]
    h = np.linalg.lstsq(np.concatenate(rows), m.T.ravel(), rcond=None)[0]
    rcm = np.append((RCM_POSITION_MM - middle) / 100.0, 1.0)
    return m_0 + h[:8].reshape(2, 4) @ rcm / (1.0 + h[8:] @ rcm[:3])


def test_without_the_correction_for_noise_the_imaged_rcm_would_be_seen_too_near() -> None:
    """±3 mm, as ±1.5° make of it, and 1 px of noise: by a sixth of its distance, and here not."""
    without, corrected = [], []
    for seed in range(30):
        scene = Scene(seed, 500, 3.0)
        points, truly = scene.seen(1.0), seen_by(scene.C, RCM_POSITION_MM[None])[0]
        without.append(share(scene, plain(scene.places, points) - truly))
        wrong, _ = off(model(scene.places, points), scene.C, RCM_POSITION_MM)
        corrected.append(share(scene, wrong))
    assert np.median(without) < -0.1
    assert abs(np.median(corrected)) < 0.05


def test_a_motion_too_short_to_tell_the_denominator_does_not_make_it_large() -> None:
    for seed in range(20):
        scene = Scene(seed, 100, 0.5)
        assert np.linalg.norm(scene.model(0.5).g) < 2.0


@given(seeds)
def test_the_deviation_of_the_pose_is_that_of_the_books(seed: int) -> None:
    scene = Scene(seed, 40)
    known, p1 = scene.model(0.3), scene.places[0]
    H = both_motions(known.rows[0], p1, SHAFT)
    pose = known.noise * np.trace(np.linalg.inv(H.T @ H))
    assert pose_deviation(known.rows[0], p1, SHAFT) == pytest.approx(np.sqrt(pose))


def test_at_rest_the_offset_averages_the_noise_and_the_sums_take_nothing() -> None:
    scene = Scene(5, 60)
    known, p1 = scene.model(0.0), scene.places[-1]
    row, sums, exact = known.rows[0], known.sums.copy(), markers_seen(scene.C, scene.places[-1])
    for noise in 0.3 * scene.random.standard_normal((200, 2, 2)):
        see(row, p1, exact + noise, SHAFT)
    assert np.abs(located(row, p1, SHAFT) - exact).max() < 4.0 * 0.3 / np.sqrt(200)
    assert np.array_equal(known.sums, sums)


def test_places_nearer_than_a_step_count_once_however_long_they_are_seen() -> None:
    p1, known = np.array([10.0, 20.0, -120.0]), blank()
    for distance, frames in (
        (0.0, 1),
        (0.9 * MIN_FRAME_SPACING_MM, 1),
        (1.1 * MIN_FRAME_SPACING_MM, 2),
        (1.2 * MIN_FRAME_SPACING_MM, 2),
    ):
        see(known.rows[0], p1 + np.array([distance, 0.0, 0.0]), np.eye(2), SHAFT)
        assert known.frames == frames


def test_one_frame_tells_where_the_markers_are_and_no_more() -> None:
    scene = Scene(1, 1)
    p1, points = scene.places[0], pictures(scene.C, scene.places)[0]
    row = model(scene.places, points[None]).rows[0]
    np.testing.assert_allclose(located(row, p1, SHAFT), points, atol=1e-9)
    covariance = imaged(row, p1 + FAR)[1]
    assert covariance.trace() > 100.0**2


def test_before_the_first_frame_nothing_is_foretold() -> None:
    row = blank().rows[0]
    assert np.isnan(expected(row, FAR, SHAFT)).all()


def test_emptied_it_is_as_at_first() -> None:
    known = Scene(0, 10).model(0.3)
    empty(known.rows[0])
    assert frozen(known) == frozen(blank())
