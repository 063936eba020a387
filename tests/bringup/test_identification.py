"""Identification of an arm and its camera from joints and markers."""

import numpy as np
import pytest

from rcmservo.bringup.identification import (
    BACKLASH,
    SPACING,
    ZERO,
    MarkerViews,
    compute_corrected_markers,
    identify,
)
from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.geometry.tool import RigidTool
from rcmservo.sim import Rig

MECHANISM, TOOL = SphericalRcm(), RigidTool(spacing=30.0)
NOISE = 0.1
"""Standard deviation (px) of a marker coordinate."""
BACKLASH_SIZES = 0.004, 0.002, 0.3
"""Backlash of the joints in rad, rad, mm."""
MAX_DEVIATIONS = 0.001, 0.001, 0.1
"""Largest standard deviations of the identified backlash in rad, rad, mm."""


def views_of(correction: list[float], seed: int) -> MarkerViews:
    """Return views of an arm with a `correction` (5,) and `BACKLASH_SIZES`, over several cm."""
    rng, rig = np.random.default_rng(seed), Rig(seed, pictures=False)
    q = rig.scene.start + np.vstack([np.zeros(3), rng.uniform(-1, 1, (39, 3)) * [0.2, 0.2, 20.0]])
    descended = rng.integers(0, 2, q.shape).astype(float)
    lost_motion = descended * BACKLASH_SIZES
    markers = compute_corrected_markers(MECHANISM, TOOL, q, np.array(correction), lost_motion)
    points = np.stack([rig.scene.optics.project(pair) for pair in markers])
    points += rng.normal(0.0, NOISE, points.shape)
    return MarkerViews(q, points, np.full(len(q), NOISE), (640, 480), descended)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("free", "correction"),
    [
        ([0, 2, ZERO], [0.1, 0.0, -0.05, 6.0, 0.0]),
        ([0, 1, SPACING], [0.05, -0.1, 0.0, 0.0, 0.2]),
        ([], [0.0] * 5),
    ],
)
def test_several_corrections_and_the_backlash_are_identified_within_their_covariance(
    free: list[int], correction: list[float], seed: int
) -> None:
    views = views_of(correction, seed)
    fit = identify(MECHANISM, TOOL, views, free)
    fitted = [*free, *range(8)[BACKLASH]]
    error = (fit.x - [*correction, *BACKLASH_SIZES])[fitted]
    covariance = fit.covariance[np.ix_(fitted, fitted)]
    assert error @ np.linalg.solve(covariance, error) < 30.0
    assert (np.sqrt(np.diag(fit.covariance)) < [0.05, 0.05, 0.05, 5.0, 0.05, *MAX_DEVIATIONS]).all()
    assert fit.misfit < 1.5 * views.points.size
