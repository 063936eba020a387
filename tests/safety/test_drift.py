"""Markers that deviate from their prediction: in one frame, on average, or if they are stuck."""

import numpy as np
import pytest

from conftest import (
    SHAFT,
    SPACING_MM,
    draw_calibration_matrix,
    draw_tool_positions,
    make_random,
    make_tick_facts,
    project_markers,
    project_points,
)
from rcmservo.control.exploration import ExplorationState
from rcmservo.estimation.camera_fit import make_initial_fit, update_fit
from rcmservo.estimation.camera_fit_prediction import predict_markers, squared_mahalanobis_distance
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import to_row
from rcmservo.safety.causes import Cause
from rcmservo.safety.checks.drift import detect_still_markers, one_marker_deviates, update_drift
from rcmservo.safety.checks.repeated_frames import detect_repeated_frame
from rcmservo.safety.innovation import find_deviating_markers
from rcmservo.safety.monitor_state import MonitorState, initial_monitor_state
from rcmservo.safety.thresholds import Thresholds

FRAME_RATE_HZ = 60.0

LIMITS = to_row(Thresholds())[0]
ALL_NOISES_PX = pytest.mark.parametrize("noise", [0.1, 0.3, 1.0])
BOTH = np.ones((2, 2))
FIRST, SECOND = np.array([[1.0, 1.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 1.0]])


class MonitoredCamera:
    """Camera with a fit of two seconds and the state of the checks; marker 1 moves within ±8 mm."""

    def __init__(self, noise: float, seed: int = 0) -> None:
        self.random, self.noise = make_random(seed), noise
        self.positions = draw_tool_positions(self.random, 120, 8.0)
        self.middle = self.positions.mean(axis=0)
        self.C = draw_calibration_matrix(self.random, self.positions)
        self.fit, self.monitor = make_initial_fit(), initial_monitor_state()
        for p1 in self.positions:
            update_fit(self.fit.rows[0], p1, self.detect(p1), SHAFT)
        self.last = self.detect(self.middle)

    def detect(self, p1: Floats) -> Floats:
        return project_markers(self.C, p1) + self.noise * self.random.standard_normal((2, 2))

    def find_cause(self, p1: Floats, points: Floats, has_arrived: bool = False) -> Cause | None:
        """Update the checks with an accepted frame and return the cause that is detected."""
        monitor, fit = self.monitor.rows[0], self.fit.rows[0]
        if not detect_repeated_frame(monitor, fit, True, p1, points, SHAFT, LIMITS):
            update_drift(monitor, fit, p1, points, SHAFT, has_arrived, LIMITS)
        facts = make_tick_facts(
            monitor=self.monitor,
            exploration_state=ExplorationState.of(is_done=True),
            thresholds=LIMITS,
        )
        candidates = Cause.DRIFTS, Cause.FROZEN
        causes = [cause for cause in candidates if cause.declared.detector(facts)]
        causes += [Cause.SURPRISED] if one_marker_deviates(facts) else []
        assert len(causes) <= 1
        return causes[0] if causes else None

    def find_deviations(self, p1: Floats, points: Floats) -> tuple[bool, bool, bool]:
        return find_deviating_markers(self.fit.rows[0], p1, points, self.last, SHAFT, LIMITS)

    def path(self, seconds: float) -> Floats:
        """Return p₁ (n, 3) mm of a tool that moves back and forth, further than during the fit."""
        time = np.arange(seconds * FRAME_RATE_HZ) / FRAME_RATE_HZ
        directions = np.stack([np.sin(0.7 * time), np.sin(1.1 * time), np.sin(1.3 * time)], axis=1)
        return self.middle + 12.0 * directions


@ALL_NOISES_PX
def test_noise_alone_is_no_drift_and_its_frames_are_accepted(noise: float) -> None:
    for seed in range(4):
        camera = MonitoredCamera(noise, seed)
        for p1 in camera.path(10.0):
            points = camera.detect(p1)
            assert camera.find_deviations(p1, points) == (False, False, False)
            assert camera.find_cause(p1, points) is None
            camera.last = points


def first_detection(camera: MonitoredCamera, speed: Floats) -> tuple[float, Cause | None]:
    """Return the time (s) and the cause of the first detection of markers that slide.

    They slide at `speed` (2, 2) px/s, after the tool has moved for a second.
    """
    for p1 in camera.path(1.0):
        camera.find_cause(p1, camera.detect(p1))
    for k, p1 in enumerate(camera.path(3.0)):
        cause = camera.find_cause(p1, camera.detect(p1) + speed * k / FRAME_RATE_HZ)
        if cause is not None:
            return k / FRAME_RATE_HZ, cause
    return np.inf, None


@pytest.mark.parametrize("speed", [4.0, -8.0])
@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_a_slow_pan_of_the_camera_is_detected_within_a_second(speed: float, noise: float) -> None:
    time, cause = first_detection(MonitoredCamera(noise), speed * BOTH)
    assert time < 1.0 and cause is Cause.DRIFTS


@pytest.mark.parametrize(("mm", "causes"), [(0.4, {None}), (4.0, {Cause.DRIFTS, Cause.SURPRISED})])
def test_a_mean_residual_that_an_arm_explains_is_no_drift(mm: float, causes: set[Cause]) -> None:
    """Markers that are off their places in space, by less than the errors of an arm or more."""
    for seed in range(6):
        camera = MonitoredCamera(0.1, seed)
        random = make_random(seed)
        offset = random.standard_normal(3)
        offset *= mm / np.linalg.norm(offset)
        found = set()
        for p1 in camera.path(2.0):
            points = camera.detect(p1 + offset)
            found.add(camera.find_cause(p1, points))
        assert found - {None} <= causes and (mm < 1.0 or found & causes)


def test_at_the_target_an_arm_may_be_less_accurate_than_on_the_way() -> None:
    """The arm reverses its motion there. On the way 1.3 mm are more than any arm explains."""
    found: dict[bool, set[Cause | None]] = {True: set(), False: set()}
    for seed in range(6):
        for has_arrived, causes in found.items():
            camera, offset = MonitoredCamera(0.1, seed), make_random(seed).standard_normal(3)
            offset *= 1.3 / np.linalg.norm(offset)
            for p1 in camera.path(2.0):
                cause = camera.find_cause(p1, camera.detect(p1 + offset), has_arrived)
                causes.add(cause)
    assert found[True] == {None} and found[False] - {None}


@pytest.mark.parametrize("sliding", [FIRST, SECOND])
def test_one_marker_that_slides_alone_is_unexpected(sliding: Floats) -> None:
    time, cause = first_detection(MonitoredCamera(0.3), 6.0 * sliding)
    assert time < 1.0 and cause is Cause.SURPRISED


def test_an_outlier_has_a_bounded_effect_on_the_mean() -> None:
    """As many outliers as may be rejected in succession cause no drift."""
    camera = MonitoredCamera(0.1)
    for p1 in camera.path(1.0):
        camera.find_cause(p1, camera.detect(p1))
    before = camera.monitor.mean_residual.copy()
    for _ in range(Thresholds.max_rejected_frames):
        assert camera.find_cause(camera.middle, camera.detect(camera.middle) + 300.0) is None
    change_px = np.linalg.norm(camera.monitor.mean_residual - before, axis=1)
    assert (change_px > 0.1).all() and (change_px < Thresholds.max_drift_px).all()


def test_no_drift_is_detected_before_the_mean_has_enough_frames() -> None:
    camera = MonitoredCamera(0.1)
    for k, p1 in enumerate(camera.path(1.0), start=1):
        cause = camera.find_cause(p1, camera.detect(p1) + 30.0)
        assert (cause is Cause.DRIFTS) == (k >= Thresholds.drift_frames)


def position_moved_by(camera: MonitoredCamera, pixels: float) -> Floats:
    """Return p₁ (3,) mm at which the predicted markers moved by `pixels` px from the middle."""
    direction, row = np.array([1.0, 0.0, 0.0]), camera.fit.rows[0]
    markers_at_middle = predict_markers(row, camera.middle, SHAFT)
    moved_markers = predict_markers(row, camera.middle + direction, SHAFT)
    px_per_mm = np.abs(moved_markers - markers_at_middle).max()
    return camera.middle + direction * pixels / px_per_mm


def find_causes_of_repetitions(
    camera: MonitoredCamera, p1: Floats, points: Floats
) -> list[Cause | None]:
    """Return the causes of as many repeated frames as stop the tool."""
    return [camera.find_cause(p1, points.copy()) for _ in range(Thresholds.max_rejected_frames)]


@pytest.mark.parametrize("pixels,cause", [(0.0, None), (0.5, None), (2.0, Cause.FROZEN)])
def test_an_identical_image_is_frozen_only_while_the_tool_moves(
    pixels: float, cause: Cause | None
) -> None:
    camera = MonitoredCamera(0.1)
    points, moved_p1 = camera.detect(camera.middle), position_moved_by(camera, pixels)
    assert camera.find_cause(camera.middle, points) is None
    assert find_causes_of_repetitions(camera, moved_p1, points) == [None, None, cause]
    changed_points = points + np.array([[0.0, 0.0], [0.0, 1e-9]])
    assert camera.find_cause(moved_p1, changed_points) is None, (
        "no camera delivers the same image twice"
    )


def least_visible_position(camera: MonitoredCamera, distance: float) -> Floats:
    """Return p₁ (3,) mm at a distance (mm) from the middle, where the markers move least."""
    row, middle, steps = camera.fit.rows[0], camera.middle, 0.5 * np.eye(3)
    changes = [
        predict_markers(row, middle + step, SHAFT) - predict_markers(row, middle - step, SHAFT)
        for step in steps
    ]
    jacobian = np.stack([change.ravel() for change in changes], axis=1)
    return middle + distance * np.linalg.svd(jacobian)[2][-1]


@pytest.mark.parametrize("fraction,cause", [(0.9, None), (1.1, Cause.FROZEN)])
def test_an_identical_image_is_frozen_although_the_motion_is_hardly_visible(
    fraction: float, cause: Cause | None
) -> None:
    camera = MonitoredCamera(0.1)
    points = camera.detect(camera.middle)
    moved_p1 = least_visible_position(camera, fraction * Thresholds.frozen_image_motion)
    row = camera.fit.rows[0]
    motion_px = np.abs(
        predict_markers(row, moved_p1, SHAFT) - predict_markers(row, camera.middle, SHAFT)
    ).max()
    assert motion_px < 0.5 * Thresholds.max_drift_px
    assert camera.find_cause(camera.middle, points) is None
    assert find_causes_of_repetitions(camera, moved_p1, points) == [None, None, cause]


@ALL_NOISES_PX
def test_a_deviating_marker_is_detected(noise: float) -> None:
    camera = MonitoredCamera(noise)
    p1, error_px = camera.middle, Thresholds.model_error + 9.0 * noise
    for moved, deviating in (
        (FIRST, (True, False)),
        (SECOND, (False, True)),
        (BOTH, (True, True)),
    ):
        points = project_markers(camera.C, p1)
        camera.last = points
        assert camera.find_deviations(p1, points + error_px * moved)[:2] == deviating
        assert camera.find_deviations(p1, points)[:2] == (False, False)


def test_swapped_markers_are_distinguished_from_far_ones() -> None:
    camera = MonitoredCamera(0.3)
    points = camera.detect(camera.middle)
    camera.last = points
    assert camera.find_deviations(camera.middle, points[::-1].copy()) == (True, True, True)
    assert camera.find_deviations(camera.middle, points + 99.0) == (True, True, False)


def test_a_marker_may_deviate_by_a_fraction_of_its_motion() -> None:
    """The joints at the exposure may have a timing error of a fraction of the frame period."""
    camera = MonitoredCamera(0.1)
    p1, points = camera.middle, project_markers(camera.C, camera.middle)
    shifted = points + np.array([4.0, 0.0])
    for motion, deviates in ((0.0, True), (40.0, False)):
        camera.last = points + np.array([motion, 0.0])
        assert camera.find_deviations(p1, shifted)[:2] == (deviates, deviates)


@pytest.mark.parametrize("k", [0, 1])
def test_nan_in_any_input_deviates(k: int) -> None:
    camera = MonitoredCamera(0.3)
    p1, points = camera.middle, camera.detect(camera.middle)
    camera.last, points_with_nan = points, points.copy()
    points_with_nan[k] = np.nan
    assert camera.find_deviations(p1, points_with_nan)[k]
    assert camera.find_deviations(np.full(3, np.nan), points)[:2] == (True, True)
    camera.fit.rows["A"] = np.nan
    assert camera.find_deviations(p1, points)[:2] == (True, True)


@pytest.mark.parametrize("part", ["A", "S_inverse", "noise_variance"])
def test_a_fit_that_is_not_finite_agrees_with_no_frame(part: str) -> None:
    """`find_deviations` rejects the frames before a residual enters the mean."""
    camera = MonitoredCamera(0.3)
    points = camera.detect(camera.middle) + 9.0
    camera.last = points
    camera.fit.rows[part] = np.nan
    assert camera.find_deviations(camera.middle, points)[:2] == (True, True)


def test_the_squared_mahalanobis_distance_equals_its_definition() -> None:
    random = make_random(0)
    for _ in range(20):
        root, x = random.standard_normal((2, 2)), random.standard_normal(2)
        cov = root @ root.T
        expected_value = x @ np.linalg.solve(cov + 0.1 * np.eye(2), x)
        squared_distance = squared_mahalanobis_distance(
            x[0], x[1], (cov[0, 0], cov[0, 1], cov[1, 1]), 0.1
        )
        assert squared_distance == pytest.approx(expected_value)


def test_the_monitored_camera_projects_the_tool_like_the_other_tests() -> None:
    camera = MonitoredCamera(0.0)
    p1 = camera.middle
    tip = p1 * (1.0 + SPACING_MM / np.linalg.norm(p1))
    np.testing.assert_allclose(camera.detect(p1), project_points(camera.C, np.stack([p1, tip])))
    np.testing.assert_allclose(
        predict_markers(camera.fit.rows[0], p1, SHAFT), camera.detect(p1), atol=0.5
    )
    assert isinstance(camera.monitor, MonitorState)


def detect_still(points: Floats, positions: Floats) -> tuple[bool, bool, bool]:
    """Return whether marker 1 and marker 2 were ever still, and whether the image was frozen.

    `points` (n, 2, 2) px are the markers with marker 1 at `positions` (n, 3) mm.
    """
    monitor, detected = initial_monitor_state().rows, np.zeros(3, bool)
    fit = make_initial_fit().rows[0]
    for p1, points_of_frame in zip(positions, points, strict=True):
        first, second = False, False
        if not detect_repeated_frame(monitor[0], fit, False, p1, points_of_frame, SHAFT, LIMITS):
            first, second = detect_still_markers(monitor[0], p1, points_of_frame, True, LIMITS)
        detected |= [first, second, MonitorState(monitor).image_frozen]
    return bool(detected[0]), bool(detected[1]), bool(detected[2])


def explore(seed: int) -> tuple[Floats, Floats]:
    """Return positions (n, 3) mm of an exploration of 10 mm, and its noisy markers (n, 2, 2) px."""
    camera = MonitoredCamera(0.3, seed)
    positions = camera.path(1.5)
    return positions, np.stack([camera.detect(p1) for p1 in positions])


@pytest.mark.parametrize("k", [0, 1])
def test_a_still_marker_is_detected_before_a_fit_exists(k: int) -> None:
    for seed in range(20):
        positions, points = explore(seed)
        assert detect_still(points, positions) == (False, False, False)
        noise = points[:, k] - points[:, k].mean(axis=0)
        points[:, k] = points[0, k] + 0.3 * noise / noise.std()
        assert detect_still(points, positions) == (k == 0, k == 1, False)


def test_a_frozen_image_is_detected_before_a_fit_exists() -> None:
    positions, points = explore(0)
    points[20:] = points[20]
    assert detect_still(points, positions) == (False, False, True)
    rest_positions = np.repeat(positions[:1], len(positions), axis=0)
    assert detect_still(points, rest_positions) == (False, False, False)
