"""Properties of the tracker: the whole ball's centre, the correct marker, and never a guess."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from conftest import ARM_RECORDING
from rcmservo.errors import BadInput
from rcmservo.interfaces import Floats, Frame, Image
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.rendering import Appearance, Renderer, Tissue
from rcmservo.tracking import ColourMarkers, MarkerAppearance, PointMarkers, read_image

SIZE = 320, 240
PAINT = {"red": (40, 30, 210), "blue": (215, 80, 30), "green": (50, 190, 40)}
SUBPIXELS = 4  # samples a pixel and axis


@dataclass(frozen=True)
class Disc:
    """Ball drawn as a flat disc, optionally shaded, highlighted or partly hidden."""

    u: float
    v: float
    radius: float = 15.0
    colour: str = "red"
    shading: float = 0.0  # fraction of light lost from one side to the other
    highlight: bool = False
    hidden: float = 0.0  # fraction of the diameter behind a dark bar 0.8 radii wide
    hidden_angle: float = 0.0


def painted(*discs: Disc, noise: float = 2.0, seed: int = 0) -> Image:
    """Return an anti-aliased image of the discs on a brownish gradient with darker bands."""
    x, y = np.arange(SIZE[0])[None, :], np.arange(SIZE[1])[:, None]
    light = 60.0 + 40.0 * x / SIZE[0] + 10.0 * np.sin(y / 17.0)
    image = light[..., None] * np.array([0.9, 1.0, 1.15])
    for disc in discs:
        _paint(image, disc)
    image += np.random.default_rng(seed).normal(0.0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _paint(image: Floats, disc: Disc) -> None:
    """Draw one disc at `SUBPIXELS` times the resolution of its surroundings."""
    reach = 2.0 * disc.radius
    left, top = max(int(disc.u - reach), 0), max(int(disc.v - reach), 0)
    window = image[top : int(disc.v + reach) + 1, left : int(disc.u + reach) + 1]
    height, width = window.shape[:2]
    fine = window.repeat(SUBPIXELS, axis=0).repeat(SUBPIXELS, axis=1)
    columns = left + (np.arange(width * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    rows = top + (np.arange(height * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    a, b = (columns[None, :] - disc.u) / disc.radius, (rows[:, None] - disc.v) / disc.radius
    inside = a**2 + b**2 < 1.0
    light = np.broadcast_to(1.0 - disc.shading * (1.0 + b) / 2.0, inside.shape)
    fine[inside] = light[inside][:, None] * np.array(PAINT[disc.colour])
    if disc.highlight:
        fine[(a + 0.3) ** 2 + (b + 0.35) ** 2 < 0.04] = 250.0
    if disc.hidden > 0.0:
        c, s = np.cos(disc.hidden_angle), np.sin(disc.hidden_angle)
        fine[(c * a + s * b > 1.0 - 2.0 * disc.hidden) & (np.abs(c * b - s * a) < 0.8)] = 35.0
    window[:] = fine.reshape(height, SUBPIXELS, width, SUBPIXELS, 3).mean(axis=(1, 3))


def frame(image: Image, number: int = 0) -> Frame:
    return Frame(number, 0, 0, image)


RED_BLUE = MarkerAppearance("red", "blue")
BLUE = Disc(250.3, 60.7, colour="blue")


# ---------------------------------------------------------------- the centre


@settings(deadline=None, max_examples=30)
@given(
    centre=st.tuples(st.floats(40, 120), st.floats(40, 200)),
    radius=st.floats(6, 30),
    shading=st.floats(0, 0.5),
    highlight=st.booleans(),
    seed=st.integers(0, 99),
)
def test_the_centre_of_a_whole_ball_does_not_depend_on_shading_or_highlights(
    centre: tuple[float, float], radius: float, shading: float, highlight: bool, seed: int
) -> None:
    red = Disc(*centre, radius, "red", shading, highlight)
    blue = Disc(250.3, 100.7, radius, "blue", shading, highlight)
    markers = ColourMarkers(RED_BLUE).find(frame(painted(red, blue, seed=seed)))
    np.testing.assert_allclose(markers.points, [centre, (250.3, 100.7)], atol=0.25)
    np.testing.assert_allclose(markers.radius, radius, atol=0.6)


@settings(deadline=None, max_examples=30)
@given(
    hidden=st.floats(0.05, 0.4),
    angle=st.floats(0, 6.28),
    radius=st.floats(8, 30),
    shading=st.floats(0, 0.3),
    seed=st.integers(0, 99),
)
def test_hiding_up_to_forty_percent_moves_the_centre_by_less_than_half_a_pixel(
    hidden: float, angle: float, radius: float, shading: float, seed: int
) -> None:
    half = replace(BLUE, radius=15.5)  # no marker is twice as large as the other
    red = Disc(120.2, 130.9, radius, "red", shading, False, hidden, angle)
    image = painted(red, half, seed=seed)
    markers = ColourMarkers(RED_BLUE).find(frame(image))
    assert np.hypot(*(markers.points[0] - (120.2, 130.9))) < 0.5


def test_rendered_balls_are_found_to_a_tenth_of_a_pixel_whole_and_three_tenths_on_a_shaft() -> None:
    for shaft_radius, limit in ((0.0, 0.15), (2.0, 0.3)):
        errors = [_rendered_error(seed, shaft_radius) for seed in range(8)]
        assert np.sqrt(np.mean(np.square(errors))) < limit


def _rendered_error(seed: int, shaft_radius: float) -> Floats:
    """Return the distances (2,) px of the tracked balls from their silhouettes' centroids."""
    random = np.random.default_rng(seed)
    eye = np.array([0.0, 0.0, 200.0])
    optics = CameraModel(
        200,
        150,
        600.0,
        np.array([100.0, 75.0]),
        np.zeros(2),
        compute_look_at_rotation(eye, np.zeros(3)),
        eye,
    )
    pitch, yaw = random.uniform(-1.0, 1.0), random.uniform(0, 2 * np.pi)
    along = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    m1, m2 = -15 * along, 15 * along
    tissue = Tissue(np.array([0.0, 0.0, -50.0]), np.array([0.0, 0.0, 1.0]))
    renderer = Renderer(optics, Appearance(shaft_radius=shaft_radius, jaw_radius=0.0), tissue, seed)
    image = renderer.render(np.array([[m1, m2, m1 - 80 * along, m2 + 15 * along]]), 0)
    truth = [optics.silhouette_centre(m, 3.5) for m in (m1, m2)]
    markers = ColourMarkers(MarkerAppearance("green", "blue")).find(frame(image))
    return np.linalg.norm(markers.points - truth, axis=1)


# ---------------------------------------------------------------- loss and recovery


def test_an_image_without_markers_gives_nan_and_quality_zero() -> None:
    for image in (
        painted(),
        painted(noise=12.0),
        np.zeros((60, 80, 3), np.uint8),
        np.zeros((1, 1, 3), np.uint8),
    ):
        markers = ColourMarkers(RED_BLUE).find(frame(image))
        assert np.isnan(markers.points).all()
        assert np.isnan(markers.radius).all()
        assert (markers.quality == 0).all()


def test_specks_and_coloured_shapes_are_not_taken_for_markers() -> None:
    image = painted(BLUE)
    image[100:180, 60:70] = PAINT["red"]
    image[30:33, 30:33] = PAINT["red"]
    image[150:200, 150:230] = PAINT["red"]
    markers = ColourMarkers(RED_BLUE).find(frame(image))
    assert np.isnan(markers.points[0]).all()
    assert markers.quality[1] > 0


@pytest.mark.parametrize("out", ["left", "right", "top", "bottom"])
def test_a_marker_that_leaves_the_image_is_lost_as_soon_as_it_touches_the_border(
    out: str,
) -> None:
    direction = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}[out]
    tracker, blue = ColourMarkers(RED_BLUE), Disc(160.0, 120.0, colour="blue")
    half = (SIZE[0] / 2, SIZE[1] / 2)
    depth = abs(half[0] * direction[0] + half[1] * direction[1])
    for step in np.arange(depth - 24, depth + 20, 4.0):
        red = Disc(half[0] - 0.5 + step * direction[0], half[1] - 0.5 + step * direction[1])
        markers = tracker.find(frame(painted(red, blue)))
        whole = step + red.radius < depth - 1.5
        if step + red.radius > depth - 0.5:
            assert np.isnan(markers.points[0]).all()
        assert (markers.quality[0] > 0) == np.isfinite(markers.points[0]).all()
        assert not whole or np.hypot(*(markers.points[0] - (red.u, red.v))) < 0.3


def test_a_marker_found_after_a_loss_has_its_new_position() -> None:
    tracker = ColourMarkers(RED_BLUE)
    tracker.find(frame(painted(Disc(60.0, 60.0), BLUE)))
    assert np.isnan(tracker.find(frame(painted(BLUE))).points[0]).all()
    markers = tracker.find(frame(painted(Disc(200.4, 190.6), BLUE)))
    np.testing.assert_allclose(markers.points[0], (200.4, 190.6), atol=0.3)


def test_a_jump_across_the_image_is_followed() -> None:
    tracker = ColourMarkers(RED_BLUE)
    for u, v in ((60.0, 60.0), (200.4, 190.6), (90.2, 180.1)):
        markers = tracker.find(frame(painted(Disc(u, v), BLUE)))
        np.testing.assert_allclose(markers.points[0], (u, v), atol=0.3)


def test_reset_restores_the_initial_state() -> None:
    image, tracker = painted(Disc(60.0, 60.0), BLUE), ColourMarkers(RED_BLUE)
    first = tracker.find(frame(image))
    tracker.find(frame(painted(Disc(70.0, 66.0), BLUE)))
    tracker.reset()
    np.testing.assert_array_equal(tracker.find(frame(image)).points, first.points)


def test_the_frame_is_not_modified_and_may_be_read_only_or_a_view() -> None:
    whole = painted(Disc(60.0, 60.0), BLUE)
    copy = whole.copy()
    whole.setflags(write=False)
    mirrored = np.ascontiguousarray(whole[:, ::-1])[:, ::-1]
    tracker = ColourMarkers(RED_BLUE)
    for image in (whole, mirrored):
        tracker.reset()
        fresh = tracker.find(frame(image))
        followed = tracker.find(frame(image))
        assert np.isfinite(fresh.points).all()
        np.testing.assert_allclose(followed.points, fresh.points, atol=0.1)
    np.testing.assert_array_equal(whole, copy)


# ---------------------------------------------------------------- identity of the markers


@pytest.mark.slow
@settings(deadline=None, max_examples=15)
@given(offset=st.floats(-6, 6), step=st.floats(4, 12), seed=st.integers(0, 99))
def test_markers_of_two_colours_are_never_swapped_where_their_paths_cross(
    offset: float, step: float, seed: int
) -> None:
    tracker = ColourMarkers(RED_BLUE)
    for x in np.arange(-60.0, 60.0, step):
        red, blue = Disc(160 + x, 120.0, 15.0), Disc(160 - x, 120.0 + offset, 14.0, "blue")
        markers = tracker.find(frame(painted(red, blue, seed=seed)))
        for point, disc in zip(markers.points, (red, blue), strict=True):
            if np.isfinite(point).all():
                assert np.hypot(*(point - (disc.u, disc.v))) < 2.0
    assert np.isfinite(markers.points).all()


@settings(deadline=None, max_examples=15)
@given(moves=st.lists(st.tuples(st.floats(-70, 70), st.floats(-50, 50)), min_size=2, max_size=6))
def test_markers_of_one_colour_are_distinguished_by_size_after_any_jump(
    moves: list[tuple[float, float]],
) -> None:
    tracker = ColourMarkers(MarkerAppearance("red", "red", radius_1=12.0, radius_2=10.0))
    for du, dv in moves:
        large, small = Disc(130 + du, 100 + dv, 24.0), Disc(190 + du, 140 + dv, 20.0)
        markers = tracker.find(frame(painted(large, small)))
        centres = [(large.u, large.v), (small.u, small.v)]
        np.testing.assert_allclose(markers.points, centres, atol=0.4)


def test_a_ring_is_no_ball() -> None:
    image = painted(BLUE, Disc(100.0, 120.0, 24.0), Disc(100.0, 120.0, 20.0, "green"))
    assert np.isnan(ColourMarkers(RED_BLUE).find(frame(image)).points[0]).all()


def test_one_ball_alone_of_two_of_one_colour_is_no_marker() -> None:
    tracker = ColourMarkers(MarkerAppearance("red", "red", radius_1=12.0, radius_2=10.0))
    tracker.find(frame(painted(Disc(100.0, 100.0, 24.0), Disc(180.0, 140.0, 20.0))))
    assert np.isnan(tracker.find(frame(painted(Disc(100.0, 100.0, 24.0)))).points).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"colour_1": "pink"}, "red, green, blue, yellow, cyan, magenta, bright"),
        ({"colour_2": ""}, "colour_2 must be one of"),
        ({"radius_1": 0.0}, "radius_1 must be a length from"),
        ({"radius_2": float("nan")}, "radius_2 must be a length from"),
        ({"colour_1": "red", "colour_2": "red"}, "radius_1 of the same colour"),
    ],
)
def test_an_unusable_appearance_is_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        MarkerAppearance(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("image", [None, np.zeros((9, 9), np.uint8), np.zeros((9, 9, 3))])
def test_a_frame_without_a_colour_image_is_refused(image: Image | None) -> None:
    with pytest.raises(BadInput, match="picture"):
        ColourMarkers().find(Frame(0, 0, 0, image))


# ---------------------------------------------------------------- points instead of pictures


def test_point_markers_return_the_finite_points() -> None:
    points = np.array([[1.0, 2.0], [np.nan, 3.0]])
    markers = PointMarkers().find(Frame(0, 0, 0, points=points))
    np.testing.assert_array_equal(markers.points, [[1.0, 2.0], [np.nan, np.nan]])
    np.testing.assert_array_equal(markers.quality, [1.0, 0.0])
    assert np.isnan(markers.radius).all()
    markers.points[0, 0] = 9.0
    assert points[0, 0] == 1.0
    with pytest.raises(BadInput, match="points"):
        PointMarkers().find(Frame(0, 0, 0))


# ---------------------------------------------------------------- the real tool


def test_both_real_balls_are_found_in_every_frame_within_two_pixels_of_one_projection() -> None:
    if not ARM_RECORDING.is_dir():
        pytest.skip("the recorded da Vinci frames are not here")
    tracker = ColourMarkers(MarkerAppearance("red", "red", radius_1=12.0, radius_2=10.0))
    images = [read_image(path) for path in sorted((ARM_RECORDING / "frames").glob("*.jpg"))]
    pixels = np.array([tracker.find(frame(image, i)).points for i, image in enumerate(images)])
    assert pixels.shape == (30, 2, 2)
    assert np.isfinite(pixels).all()
    tip = 1000 * np.genfromtxt(ARM_RECORDING / "poses.csv", delimiter=",", skip_header=1)[:, 4:7]
    n = tip / np.linalg.norm(tip, axis=1, keepdims=True)
    balls = np.stack([tip - 67 * n, tip - 17 * n], axis=1)
    residuals = _projection_residuals(balls.reshape(-1, 3), pixels.reshape(-1, 2))
    squares = (residuals.reshape(30, 2, 2) ** 2).sum(axis=2)
    assert (np.sqrt(squares.mean(axis=0)) < 2.0).all()


def _projection_residuals(points: Floats, pixels: Floats) -> Floats:
    """Return the residuals (N, 2) px of the best 3 x 4 camera matrix."""
    X = np.column_stack([(points - points.mean(axis=0)) / points.std(), np.ones(len(points))])
    scale = pixels.std()
    y = (pixels - pixels.mean(axis=0)) / scale
    rows = [np.hstack([X, 0 * X, -y[:, :1] * X]), np.hstack([0 * X, X, -y[:, 1:] * X])]
    start = np.linalg.svd(np.vstack(rows))[2][-1]

    def residuals(P: Floats) -> Floats:
        h = X @ P.reshape(3, 4).T
        return scale * (h[:, :2] / h[:, 2:] - y).ravel()

    return residuals(least_squares(residuals, start).x).reshape(-1, 2)
