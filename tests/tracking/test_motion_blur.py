"""Fit of a ball that moves by more than its radius during the exposure."""

import numpy as np
import pytest

from rcmservo.interfaces import Image
from rcmservo.tracking import local_search, motion_blur
from rcmservo.tracking.ball_fit import Ball, compile_blur_kernels, fit_blurred_ball
from rcmservo.tracking.colours import COLOURS

RED, RADIUS, CENTRE = COLOURS.index("red"), 10.0, (49.3, 52.6)
GREY = np.array([90.0, 90.0, 90.0])


def blurred_ball(motion: tuple[float, float], contrast: float, seed: int = 0) -> Image:
    """Return an image of a red ball with a white highlight that moves by `motion` px."""
    rows, columns = np.mgrid[:100, :100]
    light = np.zeros((100, 100, 3))
    for along in (np.arange(16) + 0.5) / 16 - 0.5:
        distance = np.hypot(
            columns - CENTRE[0] - along * motion[0], rows - CENTRE[1] - along * motion[1]
        )
        ball = np.where(
            distance[..., None] < 3.0, GREY + contrast, GREY + np.array([0.0, 0.0, contrast])
        )
        cover = np.clip(RADIUS + 0.5 - distance, 0.0, 1.0)[..., None]
        light += (cover * ball + (1.0 - cover) * GREY) / 16
    light += np.random.default_rng(seed).normal(0.0, 2.0, light.shape)
    return np.rint(np.clip(light, 0.0, 255.0)).astype(np.uint8)


@pytest.mark.parametrize("motion", [(15.0, 0.0), (-9.0, 12.0), (0.0, 18.0)])
def test_a_highlight_does_not_shift_a_blurred_ball(motion: tuple[float, float]) -> None:
    last = Ball(CENTRE[0] + 4.0, CENTRE[1] - 3.0, RADIUS, 1.0)
    ball = fit_blurred_ball(blurred_ball(motion, 150.0), RED, last, motion)
    assert ball
    assert np.hypot(ball.u - CENTRE[0], ball.v - CENTRE[1]) < 3.5


def test_a_blurred_ball_is_found_with_a_poorly_known_motion() -> None:
    last = Ball(*CENTRE, RADIUS, 1.0)
    ball = fit_blurred_ball(blurred_ball((12.0, 0.0), 150.0), RED, last, (7.0, 5.0))
    assert ball
    assert np.hypot(ball.u - CENTRE[0], ball.v - CENTRE[1]) < 3.0


@pytest.mark.parametrize("seed", range(5))
def test_an_image_without_a_ball_gives_no_blurred_ball(seed: int) -> None:
    last = Ball(*CENTRE, RADIUS, 1.0)
    assert fit_blurred_ball(blurred_ball((12.0, 0.0), 0.0, seed), RED, last, (12.0, 0.0)) is None
    assert fit_blurred_ball(blurred_ball((12.0, 0.0), 12.0, seed), RED, last, (12.0, 0.0)) is None
    small = blurred_ball((12.0, 0.0), 150.0)[:20, :20]
    assert fit_blurred_ball(small, RED, last, (12.0, 0.0)) is None


def test_a_jump_is_not_treated_as_motion_blur(monkeypatch: pytest.MonkeyPatch) -> None:
    """A blurred fit over a jump took up to a second and blocked everything else."""
    motions: list[float] = []

    def record(image: Image, colour: int, last: Ball, motion: tuple[float, float]) -> None:
        motions.append(float(np.hypot(*motion)))

    monkeypatch.setattr(local_search, "fit_blurred_ball", record)
    image, last = np.full((480, 640, 3), 90, dtype=np.uint8), Ball(320.0, 240.0, RADIUS, 1.0)
    for speed in (1.0, 20.0, 59.0, 61.0, 300.0, 600.0):
        assert local_search.follow_ball(image, RED, last, (speed, 0.0)) is None
    assert motions == [20.0, 59.0]


def test_the_first_frame_compiles_the_blur_kernels() -> None:
    """No compilation happens during a run."""
    compile_blur_kernels()
    kernels = motion_blur.render_blurred_disc, motion_blur.fit_blurred_outline
    before = [len(kernel.signatures) for kernel in kernels]
    test_a_highlight_does_not_shift_a_blurred_ball((15.0, 0.0))
    assert [len(kernel.signatures) for kernel in kernels] == before and all(before)
