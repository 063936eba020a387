"""Predictions of both markers and the deviation of the pose while one marker is lost."""

import numpy as np
import pytest

from conftest import (
    SHAFT,
    differentiate,
    draw_calibration_matrix,
    draw_tool_positions,
    make_random,
    project_markers,
)
from rcmservo.estimation.camera_fit import OFFSET_DECAY_MM, make_initial_fit, update_fit
from rcmservo.estimation.camera_fit_prediction import (
    compute_deviation_without_marker,
    compute_markers_jacobian,
    predict_image,
    predict_markers,
)
from rcmservo.geometry.tool import compute_second_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import replace_fields

NOISE = 0.3
EITHER = pytest.mark.parametrize("k", [0, 1])


class FitWithLostMarker:
    """Fit of 60 frames with both markers and then 60 frames without marker k.

    The second half moves to another position.
    """

    def __init__(self, seed: int, k: int) -> None:
        self.random, self.k = make_random(seed), k
        positions = draw_tool_positions(self.random, 60, 6.0)
        self.end = positions[-1] + self.random.uniform(-12.0, 12.0, 3)
        self.C = draw_calibration_matrix(self.random, np.stack([*positions, self.end]))
        self.fit = make_initial_fit()
        for p1 in positions:
            update_fit(self.fit.rows[0], p1, self.markers(p1), SHAFT)
        for p1 in np.linspace(positions[-1], self.end, 60):
            points = self.markers(p1)
            points[k] = np.nan
            update_fit(self.fit.rows[0], p1, points, SHAFT)

    def markers(self, p1: Floats) -> Floats:
        return project_markers(self.C, p1) + NOISE * self.random.standard_normal((2, 2))

    def pose_error(self) -> float:
        """Return the error of the pose in mm if the lost marker is replaced by its prediction."""
        H = differentiate(lambda p: project_markers(self.C, p).ravel(), self.end, 1e-2)
        deviation = np.zeros((2, 2))
        predicted = predict_markers(self.fit.rows[0], self.end, SHAFT)
        deviation[self.k] = predicted[self.k] - project_markers(self.C, self.end)[self.k]
        return float(np.linalg.norm(np.linalg.pinv(H) @ deviation.ravel()))


@EITHER
def test_the_deviation_of_the_pose_is_the_propagated_covariance(k: int) -> None:
    hidden = FitWithLostMarker(0, k)
    row, p1 = hidden.fit.rows[0], hidden.end
    position = p1 if k == 0 else compute_second_marker(SHAFT, p1)
    back = np.linalg.pinv(compute_markers_jacobian(row, p1, SHAFT))[:, 2 * k : 2 * k + 2]
    total = np.trace(back @ predict_image(row, position)[1] @ back.T)
    assert compute_deviation_without_marker(row, p1, k, SHAFT) == pytest.approx(np.sqrt(total))


@EITHER
def test_the_error_of_the_pose_matches_its_deviation(k: int) -> None:
    ratios = []
    for seed in range(150):
        hidden = FitWithLostMarker(seed, k)
        row = hidden.fit.rows[0]
        ratios.append(
            hidden.pose_error() / compute_deviation_without_marker(row, hidden.end, k, SHAFT)
        )
    assert 0.8 < np.sqrt(np.mean(np.minimum(ratios, 4.0) ** 2)) < 1.25
    assert np.quantile(ratios, 0.95) < 2.5


@EITHER
def test_a_lost_marker_adds_no_data_and_its_offset_decays(k: int) -> None:
    hidden, points = FitWithLostMarker(3, k), np.full((2, 2), np.nan)
    before = replace_fields(hidden.fit, offset=np.ones((2, 2)))
    after = replace_fields(before)
    there = hidden.end + np.array([OFFSET_DECAY_MM, 0.0, 0.0])
    points[1 - k] = project_markers(hidden.C, there)[1 - k]
    update_fit(after.rows[0], there, points, SHAFT)
    assert after.frame_count == before.frame_count + 0.5
    assert np.array_equal(after.marker_sums[k], before.marker_sums[k])
    assert np.any(after.marker_sums[1 - k] != before.marker_sums[1 - k])
    assert after.offset[k] == pytest.approx(np.exp(-1.0))
    assert after.offset_weight[k] == pytest.approx(before.offset_weight[k] * np.exp(-1.0))
    assert np.isfinite(after.A).all() and np.isfinite(after.noise_variance)
