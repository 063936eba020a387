"""The compiled kernels of the tracker agree with the same source run as plain Python."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from conftest import make_environment
from rcmservo.interfaces import Floats, Image
from rcmservo.tracking.ball_fit import (
    Ball,
    estimate_noise,
    fit_ball,
    fit_blurred_ball,
    fit_coarse_ball,
)
from rcmservo.tracking.colours import COLOURS, compute_colour_response, halve_resolution

CENTRE, RADIUS = (30.3, 28.6), 11.0  # px


def shaded_ball(motion: float) -> Image:
    """Return an image of a red ball, lit from one side, that moves by `motion` px."""
    rows, columns = np.mgrid[:60, :64]
    light = np.zeros((60, 64, 3))
    for shift in motion * (np.arange(8) / 7.0 - 0.5):
        x, y = (columns - CENTRE[0] - shift) / RADIUS, (rows - CENTRE[1]) / RADIUS
        distance = np.hypot(x, y)
        cosine = 0.8 * x + 0.6 * np.sqrt(np.clip(1.0 - distance**2, 0.0, 1.0))
        bright = 0.2 + 0.8 * np.clip(cosine, 0.0, 1.0)
        cover = np.clip(RADIUS * (1.0 - distance) + 0.5, 0.0, 1.0)[..., None]
        ball = bright[..., None] * np.array([30.0, 40.0, 230.0])
        light += (cover * ball + (1.0 - cover) * np.array([110.0, 100.0, 90.0])) / 8.0
    return np.rint(light).astype(np.uint8)


def fit_all() -> Floats:
    """Return the results of the sharp, the coarse and the blurred fit."""
    red, start = COLOURS.index("red"), Ball(31.0, 28.0, 10.5, 1.0)
    response = compute_colour_response(shaded_ball(0.0), red)
    sharp = fit_ball(shaded_ball(0.0), red, start.u, start.v, start.radius)
    coarse = fit_coarse_ball(response, start.u, start.v, start.radius, estimate_noise(response))
    blurred = fit_blurred_ball(shaded_ball(9.0), red, start, (9.0, 0.0))
    assert sharp and coarse and blurred
    balls = [[b.u, b.v, b.radius, b.quality] for b in (sharp, coarse, blurred)]
    arrays = sharp.covariance, blurred.covariance, halve_resolution(response)
    return np.concatenate([np.ravel(balls), *(np.ravel(other) for other in arrays)])


def test_a_half_lit_ball_and_a_blurred_ball_are_located() -> None:
    sharp, _, blurred = fit_all()[:12].reshape(3, 4)
    assert np.hypot(*(sharp[:2] - CENTRE)) < 0.1
    assert np.hypot(*(blurred[:2] - CENTRE)) < 3.0


def test_compiled_and_plain_python_fits_agree(tmp_path: Path) -> None:
    program = (
        "import numpy, test_compiled_kernels as t; "
        f"numpy.save({str(tmp_path / 'plain.npy')!r}, t.fit_all())"
    )
    environment = make_environment(NUMBA_DISABLE_JIT="1")
    subprocess.run([sys.executable, "-c", program], env=environment, check=True, timeout=120)
    np.testing.assert_allclose(fit_all(), np.load(tmp_path / "plain.npy"), rtol=1e-6, atol=1e-9)
