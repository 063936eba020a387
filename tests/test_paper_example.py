"""The paper's method in plain NumPy: it arrives, and the compiled functions compute the same."""

import ast
import importlib.util
import io
import re
import subprocess
import sys
import tokenize
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import (
    ROOT,
    SHAFT,
    SPACING_MM,
    draw_calibration_matrix,
    draw_tool_positions,
    make_observation_rows,
    make_random,
    make_rcm,
    seeds,
)
from rcmservo.control.saturated_controller import compute_controller_output, scale_rows
from rcmservo.estimation import projection_rule
from rcmservo.estimation.displacement import measure_displacement
from rcmservo.estimation.flow_rule import integrate_flow_rule
from rcmservo.geometry import features, imaged_rcm, kinematics, projection, tool
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.interfaces import Command, Floats
from rcmservo.loop.plant import Plant
from rcmservo.loop.teach import teach
from rcmservo.numerics.gradient_flow import integrate_gradient_flow
from rcmservo.safety.watchdog import WATCHDOG_TIMEOUT_NS
from rcmservo.sim import Rig
from rcmservo.tracking import PointMarkers

PATH = ROOT / "examples/paper.py"
SOURCE = PATH.read_text()
MAX_LINES = 250
EQUATIONS = set(range(1, 36))
"""Numbers of all equations of the paper."""

ROUNDING = {"rtol": 1e-9, "atol": 1e-9}
"""Tolerance of two computations of one formula: rounding."""

RATE, EPSILON = 2.0, 1e-6
"""η (1/s) and ε of the example's Γ."""

SUBSTEPS = 40
"""Steps of fourth order in which a rule is integrated; their error is below `INTEGRATED`."""

INTEGRATED = {"rtol": 1e-7, "atol": 1e-9}
"""Tolerance of a numerical and an exact integration of the same rule."""


def load_example() -> Any:
    specification = importlib.util.spec_from_file_location("paper_example", PATH)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


paper = load_example()


def integrate(rate: Any, value: Floats, duration: float) -> Floats:
    """Return `value` after `duration` s of d(value)/dt = rate(value), in steps of fourth order."""
    step = duration / SUBSTEPS
    for _ in range(SUBSTEPS):
        k1 = rate(value)
        k2 = rate(value + 0.5 * step * k1)
        k3 = rate(value + 0.5 * step * k2)
        k4 = rate(value + step * k3)
        value = value + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return value


def draw_observations(seed: int, count: int = 12) -> tuple[Floats, Floats, Floats]:
    """Return the rows [p₁ m̃₁ m̃₂] (count, 7) that a random camera observes, its a and its o_c."""
    positions = draw_tool_positions(make_random(seed), count)
    C = draw_calibration_matrix(make_random(seed + 1), positions)
    a, o_c = projection.extract_parameters(C)
    return make_observation_rows(C, positions), a, o_c


def stack_observations(rows: Floats, o_c: Floats) -> tuple[Floats, Floats]:
    """Return M (2P, 9) of eq. (24) and the pixels (2P,) of observations by the example."""
    M = np.vstack([paper.build_regressor(row[3:5] - o_c, row[:3]) for row in rows])
    return M, np.concatenate([row[3:5] - o_c for row in rows])


def draw_estimate(seed: int, a: Floats) -> Floats:
    """Return an estimate â that differs from a by up to 10 %, so that all depths are positive."""
    return a * make_random(seed + 2).uniform(0.9, 1.1, 9)


@pytest.mark.parametrize("estimator", ["flow", pytest.param("projection", marks=pytest.mark.slow)])
def test_the_paper_in_one_file_brings_the_tool_back(estimator: str) -> None:
    code = [sys.executable, "-W", "error", str(PATH), estimator]
    done = subprocess.run(code, capture_output=True, text=True, check=True)
    errors = [float(error) for error in re.findall(r"px +(\d+\.\d\d) mm", done.stdout)]
    end = re.search(r"^The tool is (\d+\.\d\d) mm from the taught pose\.$", done.stdout, re.M)
    assert len(errors) == 10 and errors[0] > 40.0
    assert errors[:6] == sorted(errors[:6], reverse=True)
    assert end is not None and float(end[1]) < 0.3


def test_the_paper_in_one_file_is_short_and_needs_numpy_only() -> None:
    assert len(SOURCE.splitlines()) <= MAX_LINES
    nodes = list(ast.walk(ast.parse(SOURCE)))
    imported = {name.name for node in nodes if isinstance(node, ast.Import) for name in node.names}
    imported |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    assert imported <= {"argparse", "numpy", "numpy.linalg"}


def test_the_paper_in_one_file_names_every_equation() -> None:
    tokens = tokenize.generate_tokens(io.StringIO(SOURCE).readline)
    prose = [token.string for token in tokens if token.type in (tokenize.COMMENT, tokenize.STRING)]
    numbers = {int(number) for number in re.findall(r"(?<=[ -])\((\d+)\)", "\n".join(prose))}
    assert numbers == EQUATIONS


@given(seeds)
def test_kinematics_1_and_2_and_their_jacobian(seed: int) -> None:
    q, rcm = make_random(seed).uniform([0.1, -3.0, 40.0], [1.5, 3.0, 220.0]), make_rcm(0)
    assert np.allclose(kinematics.compute_position(rcm, q), paper.compute_position(q), **ROUNDING)
    actual, expected = (
        kinematics.compute_position_jacobian(rcm, q),
        paper.compute_position_jacobian(q),
    )
    assert np.allclose(actual, expected, **ROUNDING)
    v = make_random(seed + 1).uniform(-50.0, 50.0, 3)
    rates = kinematics.compute_joint_rates(rcm, q, v)
    assert np.allclose(rates, np.linalg.solve(expected, v), **ROUNDING)


@given(seeds)
def test_the_second_marker_and_its_jacobian(seed: int) -> None:
    (p1,) = draw_tool_positions(make_random(seed), 1)
    p2, dp2_dp1 = paper.compute_second_marker(p1)
    assert paper.SPACING == SPACING_MM
    assert np.allclose(tool.compute_second_marker(SHAFT, p1), p2, **ROUNDING)
    assert np.allclose(tool.compute_second_marker_jacobian(SHAFT, p1), dp2_dp1, **ROUNDING)


@given(seeds)
def test_projection_3_to_13_and_its_jacobian(seed: int) -> None:
    positions = draw_tool_positions(make_random(seed), 3)
    C = draw_calibration_matrix(make_random(seed + 1), positions)
    a, _ = projection.extract_parameters(C)
    assert np.allclose(a, paper.extract_parameters(C), **ROUNDING)
    for p in positions:
        m, dm_dp = paper.project(a, p)
        assert np.allclose(projection.project(a, p), m, **ROUNDING)
        assert np.allclose(projection.compute_projection_jacobian(a, p), dm_dp, **ROUNDING)


@given(seeds)
def test_features_7_to_9_their_jacobian_and_their_error(seed: int) -> None:
    m, m_d = make_random(seed).uniform(-300.0, 300.0, (2, 4))
    y, y_d = paper.compute_features(m), paper.compute_features(m_d)
    assert np.allclose(features.compute_features(m), y, **ROUNDING)
    assert np.allclose(
        features.compute_features_jacobian(m), paper.compute_features_jacobian(m), **ROUNDING
    )
    error = features.compute_feature_error(y, y_d)
    assert np.allclose(error, paper.compute_feature_error(y, y_d), **ROUNDING)


@given(seeds)
def test_the_jacobian_15_of_estimated_parameters(seed: int) -> None:
    rows, a, _ = draw_observations(seed)
    p1, a_hat = rows[0, :3].copy(), draw_estimate(seed, a)
    predicted = projection_rule.predict_markers(a_hat, p1, SHAFT)
    actual = projection_rule.compute_estimated_jacobian(a_hat, p1, predicted, SHAFT)
    assert np.allclose(actual, paper.compute_estimated_jacobian(a_hat, p1), **ROUNDING)


@given(seeds)
def test_the_imaged_rcm_16_of_noisy_lines(seed: int) -> None:
    rows, _, o_c = draw_observations(seed)
    lines = rows[:, 3:] + make_random(seed + 2).normal(0.0, 0.3, (len(rows), 4))
    actual, _, condition = imaged_rcm.intersect_lines(lines)
    expected = paper.intersect_lines(lines)
    assert np.allclose(actual, expected, rtol=1e-12 * condition, atol=1e-12 * condition)
    assert np.allclose(paper.intersect_lines(rows[:, 3:]), o_c, atol=1e-3)


@given(seeds)
def test_regressors_17_to_20_of_the_projection(seed: int) -> None:
    rows, _, o_c = draw_observations(seed)
    M, pixels = stack_observations(rows, o_c)
    for row, W in zip(rows, M.reshape(-1, 2, 9), strict=True):
        assert np.allclose(projection.build_regressor(row[3:5] - o_c, row[:3]), W, **ROUNDING)
    points = projection_rule.collect_fitted_points(rows, len(rows), o_c, False, SHAFT)
    A, b = projection_rule.build_normal_equations(points)
    assert np.allclose(A, M.T @ M, **ROUNDING) and np.allclose(b, M.T @ pixels, **ROUNDING)


@pytest.mark.parametrize("is_printed", [True, False], ids=["printed", "fast"])
@given(seed=seeds)
def test_rule_21_over_two_time_constants_of_its_fastest_direction(
    is_printed: bool, seed: int
) -> None:
    rows, a, o_c = draw_observations(seed)
    M, pixels = stack_observations(rows, o_c)
    root = projection_rule.compute_inverse_root(M.T @ M, EPSILON)
    C = projection_rule.compute_gamma_root(root, 0.0 if is_printed else RATE)
    gamma = paper.GAMMA_0 if is_printed else C @ C.T
    a_hat = draw_estimate(seed, a)
    duration = 2.0 / np.linalg.norm(M @ C, 2) ** 2
    expected = integrate(
        lambda value: paper.compute_parameter_rate(value, M, pixels, gamma), a_hat, duration
    )
    actual = integrate_gradient_flow(M.T @ M, M.T @ pixels, a_hat, C, duration)
    assert np.allclose(actual, expected, **INTEGRATED)
    assert not np.allclose(actual, a_hat, rtol=1e-4)


@given(seeds)
def test_one_frame_of_the_projection_estimator_17_to_21(seed: int) -> None:
    """For a short time dt Euler's step of the example is the exact step of the package."""
    rows, a, o_c = draw_observations(seed)
    a_hat, dt = draw_estimate(seed, a), 1e-5
    kernel = projection_rule.ProjectionKernel(RATE, EPSILON, both_markers=False)
    memory = projection_rule.ProjectionMemory(rows.copy(), len(rows) - 1, a_hat)
    p1, points = rows[-1, :3].copy(), rows[-1, 3:].reshape(2, 2).copy()
    after = projection_rule.update_from_frame(memory, p1, points, o_c, dt, kernel, SHAFT)
    estimator = paper.ProjectionEstimator()
    estimator.a_hat = a_hat
    estimator.observations = [(row[3:5] - o_c, row[:3]) for row in rows[:-1]]
    estimator.random = SimpleNamespace(choice=lambda count, _: range(count))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper, "FRAME_PERIOD", dt)
        J_hat = estimator.update(rows[-1, 3:] - np.tile(o_c, 2), p1)
    unit = np.sqrt(np.diag(paper.GAMMA_0))
    expected = (estimator.a_hat - a_hat) / dt / unit
    assert np.allclose(
        (after.a_hat - a_hat) / dt / unit, expected, rtol=0, atol=1e-3 * np.abs(expected).max()
    )
    assert np.array_equal(J_hat, paper.compute_estimated_jacobian(estimator.a_hat, p1))


@given(seeds, st.floats(0.1, 60.0))
def test_rule_28_over_any_time(seed: int, speed: float) -> None:
    random = make_random(seed)
    J_hat, J = random.uniform(-5.0, 5.0, (2, 3, 3))
    p1_dot, dt = speed * random.standard_normal(3), 1.0 / 60.0
    y_dot = J @ p1_dot + random.normal(0.0, 10.0, 3)
    expected = integrate(lambda value: paper.compute_jacobian_rate(value, p1_dot, y_dot), J_hat, dt)
    actual = integrate_flow_rule(J_hat, p1_dot * dt, y_dot * dt, dt, paper.FLOW_GAIN)
    assert np.allclose(actual, expected, **INTEGRATED)


@given(seeds)
def test_one_frame_of_the_flow_estimator_26_to_28(seed: int) -> None:
    """For a short motion Euler's step of the example is the exact step of the package."""
    random, dt = make_random(seed), paper.FRAME_PERIOD
    J_hat, p1, m = random.uniform(-5.0, 5.0, (3, 3)), random.uniform(50.0, 90.0, 3), np.zeros(4)
    m[:2], m[2:] = random.uniform(20.0, 40.0, 2), random.uniform(60.0, 90.0, 2)
    p1_next, m_next = p1 + random.normal(0.0, 1e-3, 3), m + random.normal(0.0, 1e-3, 4)
    points, next_points = m.reshape(2, 2), m_next.reshape(2, 2)
    delta_p, delta_y = measure_displacement(p1, points, p1_next, next_points, np.zeros(2))
    expected = integrate_flow_rule(J_hat, delta_p, delta_y, dt, paper.FLOW_GAIN)
    estimator = paper.FlowEstimator()
    estimator.update(m, p1)
    estimator.J_hat = J_hat
    change = estimator.update(m_next, p1_next) - J_hat
    assert np.allclose(expected - J_hat, change, rtol=0, atol=1e-5 * np.abs(change).max())


@given(seeds, st.floats(0.01, 100.0))
def test_law_31_and_its_saturation_32(seed: int, size: float) -> None:
    random = make_random(seed)
    scaled = random.standard_normal((3, 3)) + 3.0 * np.eye(3)
    delta = size * paper.BOUNDS * random.uniform(-1.0, 1.0, 3)
    output, _ = compute_controller_output(
        scaled, delta / FEATURE_SCALE, paper.BOUNDS / FEATURE_SCALE, False, paper.GAIN, 1e9, 1e9
    )
    J_hat = scaled * FEATURE_SCALE[:, None]
    assert np.allclose(scale_rows(J_hat), scaled, **ROUNDING)
    assert np.allclose(output.v, paper.compute_velocity(J_hat, delta), **ROUNDING)


class SimulatedLaboratory:
    """Simulated arm and point camera of the package, as the example's `run` uses a laboratory."""

    def __init__(self, seed: int) -> None:
        self.rig = Rig(seed, pictures=False)
        self.plant = Plant(self.rig.arm, self.rig.camera, PointMarkers(), self.rig.clock)
        self.rig.move_to_target()
        self.taught = teach(self.plant).points.ravel()
        self.rig.go_home()
        self.plant.reset()
        self.plant.read()
        self.plant.enable()
        self.frame, self.commands = -1, 0

    def observe(self) -> tuple[Floats, Floats]:
        """Wait for the next frame, and return its raw markers and the joints at its exposure."""
        while True:
            observation = self.plant.read()
            if observation.frame > self.frame and np.isfinite(observation.q_exposure).all():
                self.frame = observation.frame
                return observation.points.ravel(), observation.q_exposure
            self.rig.clock.wait_until(self.rig.clock.now() + 4_000_000)

    def move(self, q_dot: Floats) -> None:
        now, self.commands = self.rig.clock.now(), self.commands + 1
        deadline = now + WATCHDOG_TIMEOUT_NS
        self.plant.send(Command(self.commands, now, deadline, q_dot, enabled=True))

    def compute_pose_error(self) -> float:
        """Return the true distance (mm) of marker 2 from its taught position."""
        _, p2 = self.rig.truth.markers(self.rig.clock.now())
        return float(np.linalg.norm(p2 - self.rig.body.points(self.rig.scene.target)[1]))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ProjectionEstimator", "FlowEstimator"])
def test_the_paper_in_one_file_masters_latency_lag_and_a_lens_too(name: str) -> None:
    lab = SimulatedLaboratory(0)
    before = lab.compute_pose_error()
    for _ in paper.run(getattr(paper, name)(), lab, lab.taught, duration=70.0):
        pass
    assert before > 20.0
    assert lab.compute_pose_error() < 0.5
