"""The choice of the next exploration corner, and the expected error of the path to the target."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import SHAFT, SPACING_MM, draw_calibration_matrix, make_random, project_markers, seeds
from rcmservo.control.exploration import (
    CORNER_TOLERANCE,
    CORNERS,
    Exploration,
    ExplorationState,
    set_round,
    start_exploration,
)
from rcmservo.control.exploration_planning import (
    NEGLIGIBLE_ERROR_MM,
    compute_path_error,
    direction_is_known,
    plan_corner,
)
from rcmservo.estimation.camera_fit import (
    MIN_FRAME_SPACING_MM,
    ProjectionFit,
    make_initial_fit,
    update_fit,
)
from rcmservo.geometry.kinematics import SphericalRcm, compute_position
from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import to_row
from rcmservo.safety.gate import Gate

RCM, MAX_RATES, FRAMES_PER_LEG = SphericalRcm(), np.array(Gate.speed), 8
SETTINGS = to_row(Exploration())[0]
MIN_PIXELS_PER_MM = 0.05
"""Smallest motion in the image in px/mm, in any direction; below it lies a singular surface."""


def positions_on_legs(corners: Floats) -> Floats:
    """Return marker 1 (n, 3) mm in the frames of straight legs between these joints."""
    legs = pairwise(corners)
    q = [
        start + (end - start) * (k + 1) / FRAMES_PER_LEG
        for start, end in legs
        for k in range(FRAMES_PER_LEG)
    ]
    return np.stack([compute_position(RCM.to_struct(), joints) for joints in [corners[0], *q]])


class ExploredScene:
    """A tool that has visited three corners, the true camera, and a random target."""

    def __init__(
        self, seed: int, noise: float = 0.0, near_limits: bool = False, number: int = 0
    ) -> None:
        self.random = make_random(seed)
        lower, upper = RCM.limits.arrays
        limit_fractions = self.random.uniform(0.2, 0.8, 3)
        if near_limits:
            limit_fractions[1:] = self.random.choice([0.021, 0.979], 2)
        self.home = lower + limit_fractions * (upper - lower)
        self.home[0] = np.clip(self.home[0], 0.5, 1.2)
        self.state = ExplorationState.of()
        start_exploration(
            self.state.rows[0], RCM.to_struct(), MAX_RATES, self.home, 0, 0.0, SETTINGS
        )
        sides = self.state.sides.copy()
        self.corners = self.home + np.vstack([np.zeros(3), CORNERS[:3]]) * sides
        self.state.rows["visited_corners"] = 4 * number
        set_round(self.state.rows[0], RCM.to_struct(), MAX_RATES, 0.0, SETTINGS)
        self.state.rows["visited_corners"] = 3
        self.q, self.positions = self.corners[-1], positions_on_legs(self.corners)
        self.p1 = self.positions[-1]
        self.C = self.camera()
        self.fit = self.fit_frames(noise)
        direction = self.random.standard_normal(3)
        self.target_position = self.p1 + 9.0 * direction / np.linalg.norm(direction)
        self.target = project_markers(self.C, self.target_position)

    def camera(self) -> Floats:
        """Return a camera in whose image every motion of marker 1 is visible."""
        while True:
            C = draw_calibration_matrix(self.random, self.positions)
            positions = self.p1 + 0.5 * np.vstack([np.eye(3), -np.eye(3)])
            pixels = [project_markers(C, p).ravel() for p in positions]
            H = np.stack([pixels[i] - pixels[i + 3] for i in range(3)], axis=1)
            if np.linalg.svd(H, compute_uv=False)[-1] > MIN_PIXELS_PER_MM:
                return C

    def fit_frames(self, noise: float, more: Floats | None = None) -> ProjectionFit:
        fit = make_initial_fit()
        for p in self.positions if more is None else np.vstack([self.positions, more]):
            points = project_markers(self.C, p)
            points = points + noise * self.random.standard_normal((2, 2))
            update_fit(fit.rows[0], p, points, SHAFT)
        return fit

    def plan(self) -> Floats:
        """Return the next corner."""
        self.state.rows["next_corner"] = np.nan
        rcm, max_leg_mm = RCM.to_struct(), Exploration.max_leg_length
        plan_corner(
            self.state.rows[0], self.fit.rows[0], rcm, SHAFT, self.q, self.target, max_leg_mm
        )
        return self.state.next_corner

    def allowed(self) -> list[Floats]:
        """Return the corners that may be planned."""
        result, (lower, upper) = [], RCM.limits.arrays
        margin = 0.02 * (upper - lower)
        for steps in product((-1, 0, 1), repeat=3):
            q = self.home + np.array(steps) * self.state.sides
            free = (q >= lower + margin) & (q <= upper - margin) | (np.array(steps) == 0)
            is_near = (
                np.linalg.norm(compute_position(RCM.to_struct(), q) - self.p1)
                <= Exploration.max_leg_length
            )
            same = (np.abs(q - self.q) <= CORNER_TOLERANCE * np.abs(self.state.sides)).all()
            result += [q] if free.all() and is_near and not same else []
        return result


def predicted_pixels(fit: ProjectionFit, p: Floats, change: Floats | float = 0.0) -> Floats:
    """Return the markers (4,) px from m₀ by a fit whose θ differs by `change`."""
    theta = np.concatenate([fit.A.ravel(), fit.g]) + change
    both = np.stack([p, p * (1.0 + SPACING_MM / np.linalg.norm(p))])
    x = np.column_stack([(both - fit.origin[:3]) / 100.0, np.ones(2)])
    return ((x @ theta[:8].reshape(2, 4).T) / (1.0 + x[:, :3] @ theta[8:])[:, None]).ravel()


def theta_jacobian(fit: ProjectionFit, p: Floats) -> Floats:
    """Return ∂m/∂θ (4, 11) of both markers by differences."""
    steps = 1e-4 * np.eye(11)
    return (
        np.stack(
            [predicted_pixels(fit, p, s) - predicted_pixels(fit, p, -s) for s in steps], axis=1
        )
        / 2e-4
    )


def pinv_jacobian(fit: ProjectionFit, p: Floats) -> Floats:
    """Return H⁺ (3, 4) of the fit by differences."""
    steps = 1e-3 * np.eye(3)
    H = (
        np.stack(
            [predicted_pixels(fit, p + s) - predicted_pixels(fit, p - s) for s in steps], axis=1
        )
        / 2e-3
    )
    return np.linalg.pinv(H)


def positions_in_sums(positions: Floats) -> list[Floats]:
    """Return the positions that the sums of the fit take."""
    result = [positions[0]]
    for p in positions:
        result += [p] if np.linalg.norm(p - result[-1]) >= MIN_FRAME_SPACING_MM else []
    return result


def path_to_target(scene: ExploredScene) -> Floats:
    """Return the path to the target in mm by the fit."""
    pixels = (
        predicted_pixels(scene.fit, scene.p1)
        + scene.fit.offset.ravel()
        + np.tile(scene.fit.origin[3:], 2)
    )
    return pinv_jacobian(scene.fit, scene.p1) @ (scene.target.ravel() - pixels)


class Textbook:
    """Expected error of the path to the target, by NumPy alone."""

    def __init__(self, scene: ExploredScene) -> None:
        self.fit = scene.fit
        D = np.concatenate(
            [theta_jacobian(scene.fit, p) for p in positions_in_sums(scene.positions)]
        )
        self.N = D.T @ D + scene.fit.noise_variance * np.diag([1e-6] * 8 + [1.0] * 3)
        path = path_to_target(scene)
        fraction = min(10.0 / np.linalg.norm(path), 1.0)
        jacobian_change = theta_jacobian(scene.fit, scene.p1 + fraction * path) - theta_jacobian(
            scene.fit, scene.p1
        )
        self.T = pinv_jacobian(scene.fit, scene.p1) @ jacobian_change / fraction

    def error(self, more: Floats | tuple[()] = (), weights: Floats | tuple[()] = ()) -> float:
        """Return the expected error after more frames with these weights."""
        E = [np.sqrt(w) * theta_jacobian(self.fit, p) for p, w in zip(more, weights, strict=True)]
        N = sum((e.T @ e for e in E), self.N)
        return float(
            np.sqrt(self.fit.noise_variance * np.trace(self.T @ np.linalg.solve(N, self.T.T)))
        )


@given(seeds)
@settings(max_examples=20)
def test_the_error_of_the_path_follows_the_textbook_formula(seed: int) -> None:
    scene = ExploredScene(seed)
    error, distance = compute_path_error(scene.fit.rows[0], scene.p1, scene.target, SHAFT)
    assert error == pytest.approx(Textbook(scene).error(), rel=0.05)
    assert distance == pytest.approx(np.linalg.norm(path_to_target(scene)))


@given(seeds, st.booleans(), st.integers(0, 1))
@settings(max_examples=12)
def test_the_next_corner_minimises_the_expected_error(
    seed: int, near_limits: bool, number: int
) -> None:
    """It holds near the joint limits and in rounds of different size."""
    scene = ExploredScene(seed, near_limits=near_limits, number=number)
    frames, errors, corners, textbook = (
        scene.fit.frame_count / 3,
        [],
        scene.allowed(),
        Textbook(scene),
    )
    for q in corners:
        to = compute_position(RCM.to_struct(), q)
        points = np.stack([scene.p1, 0.5 * (scene.p1 + to), to])
        errors.append(textbook.error(points, frames * np.array([1.0, 4.0, 1.0]) / 6.0))
    goal = scene.plan()
    chosen = [error for q, error in zip(corners, errors, strict=True) if np.allclose(q, goal)]
    assert chosen and chosen[0] <= min(errors) * 1.01


def test_the_expected_error_matches_the_observed_error() -> None:
    """Before the planned leg, the expected error is the rms error of noisy fits after it."""
    squared, expected = [], []
    for seed in range(12):
        scene = ExploredScene(seed)
        leg = positions_on_legs(np.stack([scene.q, scene.plan()]))[1:]
        full = scene.fit_frames(0.0, leg)
        full.rows["noise_variance"] = 0.3**2
        expected.append(compute_path_error(full.rows[0], scene.p1, scene.target, SHAFT)[0] ** 2)
        H_pinv, exact = pinv_jacobian(full, scene.p1), predicted_motion(full, scene)
        for _ in range(20):
            error_px = predicted_motion(scene.fit_frames(0.3, leg), scene) - exact
            squared.append(np.sum((H_pinv @ error_px) ** 2))
    assert 0.8 < np.sqrt(np.mean(squared) / np.mean(expected)) < 1.25


def predicted_motion(fit: ProjectionFit, scene: ExploredScene) -> Floats:
    """Return the motion (4,) px of the markers on the path to the target by the fit."""
    return predicted_pixels(fit, scene.target_position) - predicted_pixels(fit, scene.p1)


def test_servoing_begins_sooner_towards_a_target_whose_direction_is_known_better() -> None:
    """The tool has moved far to and fro along one direction, and little across it."""
    ratios = []
    for seed in range(10):
        scene = ExploredScene(seed)
        directions = np.linalg.qr(scene.random.standard_normal((3, 3)))[0]
        steps = 3.0 * np.linspace(-1.0, 1.0, 30)[:, None] * directions[0]
        scene.positions = scene.p1 + steps + 0.3 * scene.random.standard_normal((30, 3))
        row, relative_errors = scene.fit_frames(0.1).rows[0], []
        for direction in directions:
            target = project_markers(scene.C, scene.p1 + 3.0 * direction)
            error, distance = compute_path_error(row, scene.p1, target, SHAFT)
            relative_errors.append(error / distance)
        ratios.append(relative_errors[0] / np.mean(relative_errors[1:]))
    assert np.median(ratios) < 0.6


@given(seeds)
@settings(max_examples=10)
def test_the_direction_is_known_below_the_relative_error_that_is_set(seed: int) -> None:
    """It is also known if the error is negligible."""
    scene = ExploredScene(seed, noise=1.0)
    error, distance = compute_path_error(scene.fit.rows[0], scene.p1, scene.target, SHAFT)
    for limit in (0.9, 1.1):
        settings_row = to_row(Exploration(uncertainty=limit * error / distance))[0]
        assert direction_is_known(
            scene.fit.rows[0], scene.p1, scene.target, SHAFT, settings_row
        ) == (limit > 1.0 or error <= NEGLIGIBLE_ERROR_MM)


@given(seeds)
@settings(max_examples=10)
def test_a_negligible_error_is_accepted_for_any_path_length(
    seed: int,
) -> None:
    for noise in (3.0, 6.0, 12.0, 24.0):  # until the error is a large fraction of the path
        scene = ExploredScene(seed, noise)
        a_mm = error_of_target(scene, 0.1)[0] / 0.1
        if a_mm > 3.0 * SETTINGS["uncertainty"]:
            break
    for fraction in (0.2, 0.8, 1.25, 3.0):
        error, distance = error_of_target(scene, fraction * NEGLIGIBLE_ERROR_MM / a_mm)
        if error > 2.0 * SETTINGS["uncertainty"] * distance:
            assert direction_is_known(
                scene.fit.rows[0], scene.p1, scene.target, SHAFT, SETTINGS
            ) == (error <= NEGLIGIBLE_ERROR_MM)


def error_of_target(scene: ExploredScene, mm: float) -> tuple[float, float]:
    """Return the error and the length of the path to a target that the fit predicts `mm` away."""
    direction = (scene.target_position - scene.p1) / np.linalg.norm(
        scene.target_position - scene.p1
    )
    scene.target = (
        predicted_pixels(scene.fit, scene.p1 + mm * direction).reshape(2, 2)
        + scene.fit.origin[3:]
        + scene.fit.offset
    )
    return compute_path_error(scene.fit.rows[0], scene.p1, scene.target, SHAFT)


@given(seeds)
@settings(max_examples=10)
def test_at_the_target_the_direction_is_known_and_a_corner_is_still_planned(
    seed: int,
) -> None:
    scene = ExploredScene(seed)
    scene.target = project_markers(scene.C, scene.p1) + scene.fit.offset
    assert direction_is_known(scene.fit.rows[0], scene.p1, scene.target, SHAFT, SETTINGS)
    assert any(np.allclose(scene.plan(), q) for q in scene.allowed())


def test_without_frames_no_direction_is_known_and_the_corner_stays() -> None:
    scene = ExploredScene(0)
    scene.fit = make_initial_fit()
    assert not direction_is_known(scene.fit.rows[0], scene.p1, scene.target, SHAFT, SETTINGS)
    assert np.isnan(scene.plan()).all()
