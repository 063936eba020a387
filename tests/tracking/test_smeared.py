"""A ball that moves by more than its radius while the picture is exposed."""

import numpy as np
import pytest

from rcmservo.interfaces import Image
from rcmservo.tracking import close, smeared
from rcmservo.tracking.ball import Ball, prepare_smeared, smeared_ball
from rcmservo.tracking.colours import COLOURS

RED, RADIUS, CENTRE = COLOURS.index("red"), 10.0, (49.3, 52.6)
GREY = np.array([90.0, 90.0, 90.0])


def picture_of(smear: tuple[float, float], contrast: float, seed: int = 0) -> Image:
    """A red ball with a white highlight in its middle, as it shows while it moves by `smear` px."""
    rows, columns = np.mgrid[:100, :100]
    light = np.zeros((100, 100, 3))
    for along in (np.arange(16) + 0.5) / 16 - 0.5:
        away = np.hypot(columns - CENTRE[0] - along * smear[0], rows - CENTRE[1] - along * smear[1])
        ball = np.where(
            away[..., None] < 3.0, GREY + contrast, GREY + np.array([0.0, 0.0, contrast])
        )
        cover = np.clip(RADIUS + 0.5 - away, 0.0, 1.0)[..., None]
        light += (cover * ball + (1.0 - cover) * GREY) / 16
    light += np.random.default_rng(seed).normal(0.0, 2.0, light.shape)
    return np.rint(np.clip(light, 0.0, 255.0)).astype(np.uint8)


@pytest.mark.parametrize("smear", [(15.0, 0.0), (-9.0, 12.0), (0.0, 18.0)])
def test_it_is_found_where_it_is_whatever_shines_in_its_middle(smear: tuple[float, float]) -> None:
    last = Ball(CENTRE[0] + 4.0, CENTRE[1] - 3.0, RADIUS, 1.0)
    ball = smeared_ball(picture_of(smear, 150.0), RED, last, smear)
    assert ball
    assert np.hypot(ball.u - CENTRE[0], ball.v - CENTRE[1]) < 3.5


def test_it_is_found_though_its_way_is_not_known_well() -> None:
    last = Ball(*CENTRE, RADIUS, 1.0)
    ball = smeared_ball(picture_of((12.0, 0.0), 150.0), RED, last, (7.0, 5.0))
    assert ball
    assert np.hypot(ball.u - CENTRE[0], ball.v - CENTRE[1]) < 3.0


@pytest.mark.parametrize("seed", range(5))
def test_where_there_is_none_none_is_found(seed: int) -> None:
    last = Ball(*CENTRE, RADIUS, 1.0)
    assert smeared_ball(picture_of((12.0, 0.0), 0.0, seed), RED, last, (12.0, 0.0)) is None
    assert smeared_ball(picture_of((12.0, 0.0), 12.0, seed), RED, last, (12.0, 0.0)) is None
    small = picture_of((12.0, 0.0), 150.0)[:20, :20]
    assert smeared_ball(small, RED, last, (12.0, 0.0)) is None


def test_a_marker_that_jumps_is_not_looked_for_as_one_that_is_smeared_by_its_jump(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """That took up to a second, in which nothing else ran."""
    looked: list[float] = []

    def noted(image: Image, colour: int, last: Ball, way: tuple[float, float]) -> None:
        looked.append(float(np.hypot(*way)))

    monkeypatch.setattr(close, "smeared_ball", noted)
    picture, last = np.full((480, 640, 3), 90, dtype=np.uint8), Ball(320.0, 240.0, RADIUS, 1.0)
    for way in (1.0, 20.0, 59.0, 61.0, 300.0, 600.0):
        assert close.ball_followed(picture, RED, last, (way, 0.0)) is None
    assert looked == [20.0, 59.0]


def test_all_that_a_smeared_ball_needs_is_loaded_with_the_first_frame() -> None:
    """Nothing is compiled in mid-run."""
    prepare_smeared()
    kernels = smeared.smeared_disc, smeared.smeared_outline
    before = [len(kernel.signatures) for kernel in kernels]
    test_it_is_found_where_it_is_whatever_shines_in_its_middle((15.0, 0.0))
    assert [len(kernel.signatures) for kernel in kernels] == before and all(before)
