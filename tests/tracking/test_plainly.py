"""The tracker's compiled functions say what the same source says as plain Python."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from conftest import with_tests
from rcmservo.interfaces import Floats, Image
from rcmservo.tracking.ball import Ball, ball_about, ball_near, noise, smeared_ball
from rcmservo.tracking.colours import COLOURS, halved, weights

CENTRE, RADIUS = (30.3, 28.6), 11.0  # px


def shaded_ball(smear: float) -> Image:
    """A red ball that a lamp beside the camera lights, and that moves sideways by `smear` px."""
    rows, columns = np.mgrid[:60, :64]
    light = np.zeros((60, 64, 3))
    for shift in smear * (np.arange(8) / 7.0 - 0.5):
        x, y = (columns - CENTRE[0] - shift) / RADIUS, (rows - CENTRE[1]) / RADIUS
        away = np.hypot(x, y)
        facing = 0.8 * x + 0.6 * np.sqrt(np.clip(1.0 - away**2, 0.0, 1.0))
        bright = 0.2 + 0.8 * np.clip(facing, 0.0, 1.0)
        cover = np.clip(RADIUS * (1.0 - away) + 0.5, 0.0, 1.0)[..., None]
        ball = bright[..., None] * np.array([30.0, 40.0, 230.0])
        light += (cover * ball + (1.0 - cover) * np.array([110.0, 100.0, 90.0])) / 8.0
    return np.rint(light).astype(np.uint8)


def found() -> Floats:
    """Numbers of every way to look at a ball."""
    red, there = COLOURS.index("red"), Ball(31.0, 28.0, 10.5, 1.0)
    amounts = weights(shaded_ball(0.0), red)
    near = ball_near(shaded_ball(0.0), red, there.u, there.v, there.radius)
    about = ball_about(amounts, there.u, there.v, there.radius, noise(amounts))
    smeared = smeared_ball(shaded_ball(9.0), red, there, (9.0, 0.0))
    assert near and about and smeared
    balls = [[b.u, b.v, b.radius, b.quality] for b in (near, about, smeared)]
    others = near.covariance, smeared.covariance, halved(amounts)
    return np.concatenate([np.ravel(balls), *(np.ravel(other) for other in others)])


def test_a_half_lit_and_a_smeared_ball_are_where_they_are() -> None:
    sharp, _, smeared = found()[:12].reshape(3, 4)
    assert np.hypot(*(sharp[:2] - CENTRE)) < 0.1
    assert np.hypot(*(smeared[:2] - CENTRE)) < 3.0


def test_balls_are_the_same_compiled_and_as_plain_python(tmp_path: Path) -> None:
    program = (
        f"import numpy, test_plainly as t; numpy.save({str(tmp_path / 'plain.npy')!r}, t.found())"
    )
    plainly = with_tests(NUMBA_DISABLE_JIT="1")
    subprocess.run([sys.executable, "-c", program], env=plainly, check=True, timeout=120)
    np.testing.assert_allclose(found(), np.load(tmp_path / "plain.npy"), rtol=1e-6, atol=1e-9)
