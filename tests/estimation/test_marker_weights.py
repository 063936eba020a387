"""Weights of markers: false detections hardly change the projection fit, and it recovers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import (
    SHAFT,
    SPACING_MM,
    draw_calibration_matrix,
    draw_tool_positions,
    make_random,
    project_markers,
    seeds,
)
from rcmservo.estimation.camera_fit import ProjectionFit, make_initial_fit, update_fit
from rcmservo.estimation.camera_fit_prediction import predict_image, weigh_markers
from rcmservo.interfaces import Floats

NOISE_PX = 0.3


class Stream:
    """Frames of a camera and a tool that moves at random within ±6 mm, and their fit."""

    def __init__(self, seed: int, is_weighted: bool = True) -> None:
        self.random = make_random(seed)
        self.positions = draw_tool_positions(self.random, 400, 6.0)
        self.C = draw_calibration_matrix(self.random, self.positions[:20])
        self.fit, self.is_weighted = make_initial_fit(), is_weighted
        self.shift = np.zeros(2)

    def add(self, p1: Floats, misplaced: int | None = None) -> ProjectionFit:
        """Add a frame, in which a marker may be 30 to 100 px from its place; return the fit."""
        points = project_markers(self.C, p1) + self.shift
        points += NOISE_PX * self.random.standard_normal((2, 2))
        angle, distance = self.random.uniform(0, 2 * np.pi), self.random.uniform(30, 100)
        if misplaced is not None:
            points[misplaced] += distance * np.array([np.cos(angle), np.sin(angle)])
        row = self.fit.rows[0]
        if self.is_weighted:
            weigh_markers(row, p1, points, SHAFT)
        update_fit(row, p1, points, SHAFT)
        return self.fit

    def error_px(self) -> float:
        """Return the rms error (px) of predicted markers at the positions of the stream."""
        errors = []
        for p1 in self.positions[:50]:
            positions = p1, p1 * (1.0 + SPACING_MM / np.linalg.norm(p1))
            predicted = np.array([predict_image(self.fit.rows[0], p)[0] for p in positions])
            errors.append(predicted - project_markers(self.C, p1) - self.shift)
        return float(np.sqrt(np.mean(np.square(errors))))


@given(seeds)
def test_gaussian_noise_leaves_every_weight_at_one(seed: int) -> None:
    stream = Stream(seed)
    for p1 in stream.positions[:100]:
        assert np.array_equal(stream.add(p1).marker_weights, [1.0, 1.0])


@given(seeds, st.integers(0, 1))
def test_a_false_detection_loses_its_weight_and_the_other_marker_keeps_it(
    seed: int, misplaced: int
) -> None:
    stream = Stream(seed)
    for p1 in stream.positions[:60]:
        stream.add(p1)
    weights = stream.add(stream.positions[60], misplaced).marker_weights
    assert weights[misplaced] < 0.05 and weights[1 - misplaced] == 1.0


@pytest.mark.parametrize("share", [0.05, 0.1])
def test_wrong_frames_from_the_start_hardly_change_the_fit(share: float) -> None:
    """Without the weights the same frames spoil it."""
    errors = {}
    for is_weighted in (True, False):
        errors[is_weighted] = []
        for seed in range(40):
            stream = Stream(seed, is_weighted)
            for p1 in stream.positions[:200]:
                is_wrong = stream.random.random() < share
                stream.add(p1, int(stream.random.integers(2)) if is_wrong else None)
            errors[is_weighted].append(stream.error_px())
    assert np.quantile(errors[True], 0.9) < 1.0
    assert np.quantile(errors[False], 0.9) > 5.0


@pytest.mark.parametrize("wrong_frames", [1, 2, 3])
def test_a_fit_to_wrong_frames_is_changed_by_the_right_ones_that_follow(wrong_frames: int) -> None:
    """All of the first frames are wrong: the right ones are outliers to such a fit."""
    errors = []
    for seed in range(20):
        stream = Stream(seed)
        for i, p1 in enumerate(stream.positions):
            stream.add(p1, 0 if i < wrong_frames else None)
        errors.append(stream.error_px())
    assert np.median(errors) < 3.0 and np.quantile(errors, 0.9) < 6.0


@pytest.mark.parametrize("lost", [0, 1])
def test_a_lost_marker_has_no_false_detection(lost: int) -> None:
    stream = Stream(3)
    for p1 in stream.positions[:60]:
        stream.add(p1)
    p1 = stream.positions[60]
    points = project_markers(stream.C, p1)
    points[lost] = np.nan
    weigh_markers(stream.fit.rows[0], p1, points, SHAFT)
    assert np.array_equal(stream.fit.marker_weights, [1.0, 1.0])
