"""Update of the estimate by an accepted frame: projection fit, imaged RCM, Ĵ and features.

An estimator that compiles has a kernel, and the class of the kernel selects the functions that are
called here (estimator_kernels.py). An estimator that does not compile runs in Python, between
`fit_frame` and `store_estimate`.
"""

from typing import Any, cast

import numpy as np

from rcmservo.estimation.base import Estimate, KernelSample
from rcmservo.estimation.camera_fit import update_fit
from rcmservo.estimation.camera_fit_prediction import weigh_markers
from rcmservo.geometry.features import (
    POINTS_CODE,
    SRD_CODE,
    compute_features_and_error,
    compute_line_features,
    limit_origin_distance,
    wrap_angle,
    write_line_features_jacobian,
    write_shifted_to_rcm,
)
from rcmservo.geometry.imaged_rcm import RcmSolution, compute_uncertainty, update_imaged_rcm
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled, declare_in
from rcmservo.numerics.small_linalg import all_finite, copy_into, multiply_into
from rcmservo.safety.monitor_state import monitor_estimate
from rcmservo.servo.kernel_parameters import KernelParameters, TickContext, make_tool_struct
from rcmservo.servo.state import EstimatorMemory, Workspace
from rcmservo.servo.target_gap import aim_at_target, filter_weak_directions, predict_target

NO_FRAME, FRAME_ACCEPTED, FRAME_UPDATES = 0, 1, 2
"""Results of a frame: not accepted or not new, accepted, or accepted and used to update Ĵ."""

MAX_ORIGIN_DISTANCE_PX = 800.0
"""Largest distance (px) from the markers to the origin about which their features are computed."""


@compiled
def fit_frame(tick: TickContext, line_memory: Floats) -> tuple[Floats, int]:
    """Update the projection fit and eq. (16) by the markers, of which one may be lost.

    A line through a false detection is left out, and one at a place that the fit has seen already.
    The paper's (16) as printed takes every line.

    Returns
    -------
    tuple
        Memory of eq. (16) after the frame; FRAME_UPDATES if they determine the imaged RCM or the
        estimator computes it, else FRAME_ACCEPTED.
    """
    estimate, points, parameters = tick.stored.estimate, tick.observation.points, tick.parameters
    fit, shaft = tick.stored.projection_fit, make_tool_struct(parameters)
    frames_before = fit.frame_count
    weigh_markers(fit, estimate.p1, points, shaft)
    update_fit(fit, estimate.p1, points, shaft)
    predict_target(tick)
    aim_at_target(tick)
    unknown_result = FRAME_UPDATES if parameters.estimates_rcm else FRAME_ACCEPTED
    if not all_finite(points):
        return line_memory, unknown_result
    is_right = fit.marker_weights[0] == 1.0 and fit.marker_weights[1] == 1.0
    if parameters.uses_paper_rcm or (is_right and fit.frame_count > frames_before):
        line_memory, estimate.line_count, solution = update_imaged_rcm(
            line_memory, estimate.line_count, points, parameters.uses_paper_rcm
        )
        store_imaged_rcm(estimate, solution, parameters)
    return line_memory, FRAME_UPDATES if estimate.rcm_uncertainty <= 1.0 else unknown_result


@compiled
def store_imaged_rcm(
    estimate: Estimate, solution: RcmSolution, parameters: KernelParameters
) -> None:
    """Store the solution of eq. (16), and its uncertainty as a ratio of its limit."""
    settings, m1 = parameters.imaged_rcm, estimate.points[0]
    copy_into(estimate.o_c, solution.o_c)
    copy_into(estimate.o_c_covariance, solution.covariance)
    estimate.rcm_condition = solution.condition
    estimate.rcm_uncertainty = compute_uncertainty(
        solution, m1, settings.max_condition, settings.max_deviation, parameters.uses_paper_rcm
    )


@compiled
def make_sample(tick: TickContext, dt: float, fit_changed: bool) -> KernelSample:
    """Return the accepted frame as a sample for the estimator's kernel."""
    estimate, parameters = tick.stored.estimate, tick.parameters
    points, shaft = tick.observation.points, make_tool_struct(parameters)
    needs_jacobian = parameters.needs_markers_jacobian
    return KernelSample(estimate.p1, points, estimate.o_c, dt, shaft, needs_jacobian, fit_changed)


@compiled
def update_with_lines(
    kernel: Any, memory: EstimatorMemory, tick: TickContext, dt: float
) -> tuple[EstimatorMemory, int]:
    """Implement `update_estimator` for an estimator that uses the imaged RCM of eq. (16)."""
    line_memory, frame_result = fit_frame(tick, memory.line_memory)
    own_memory, fit = memory.memory, tick.stored.projection_fit
    if frame_result == FRAME_UPDATES:
        sample, result = make_sample(tick, dt, True), tick.stored.estimator_result
        own_memory = run_kernel(kernel, own_memory, sample, fit, result)
    return EstimatorMemory(line_memory, own_memory), frame_result


@compiled
def update_with_fit(kernel: Any, memory: Any, tick: TickContext, dt: float) -> tuple[Any, int]:
    """Implement `update_estimator` for an estimator that computes the imaged RCM itself."""
    stored, estimate = tick.stored, tick.stored.estimate
    fit, result = stored.projection_fit, stored.estimator_result
    frames_before, shaft = fit.frame_count, make_tool_struct(tick.parameters)
    weigh_markers(fit, estimate.p1, tick.observation.points, shaft)
    update_fit(fit, estimate.p1, tick.observation.points, shaft)
    predict_target(tick)
    aim_at_target(tick)
    copy_into(result.o_c, estimate.o_c)
    copy_into(result.o_c_covariance, estimate.o_c_covariance)
    fit_changed = fit.frame_count > frames_before or estimate.rcm_condition > 0.0
    sample = make_sample(tick, dt, fit_changed)
    return run_kernel(kernel, memory, sample, fit, result), FRAME_UPDATES


@compiled
def empty_with_lines(kernel: Any, memory: EstimatorMemory) -> EstimatorMemory:
    """Implement `empty_memory` for an estimator that uses the imaged RCM of eq. (16)."""
    line_memory = np.zeros_like(memory.line_memory)
    return EstimatorMemory(line_memory, empty_own_memory(kernel, memory.memory))


UPDATES = {False: update_with_lines, True: update_with_fit}
"""Implementations of `update_estimator`; True: the estimator computes the imaged RCM itself."""


def update_estimator(kernel: Any, memory: Any, tick: TickContext, dt: float) -> tuple[Any, int]:
    """Update an estimator that compiles by an accepted frame, dt s after the previous one.

    Returns
    -------
    tuple
        Memory of the estimator; FRAME_UPDATES if it computed a result, else FRAME_ACCEPTED.
    """
    return UPDATES[kernel.estimates_rcm](kernel, memory, tick, dt)


def empty_memory(kernel: Any, memory: Any) -> Any:
    """Return the memory of the estimator before the first frame."""
    return (empty_own_memory if kernel.estimates_rcm else empty_with_lines)(kernel, memory)


def run_kernel(kernel: Any, memory: Any, sample: KernelSample, fit: Any, result: Any) -> Any:
    """Call `update` of the kernel's class and return the estimator's memory."""
    update = cast(Any, type(kernel)).update
    return update(kernel, memory, sample, fit, result)


def empty_own_memory(kernel: Any, memory: Any) -> Any:
    """Call `reset` of the kernel's class and return the estimator's memory."""
    reset = cast(Any, type(kernel)).reset
    return reset(kernel, memory)


declare_in("rcmservo.servo.estimator_kernels")


@compiled
def store_estimate(tick: TickContext) -> None:
    """Compute features and error from the estimator's result, and check the estimate by them."""
    stored, feature_code = tick.stored, tick.parameters.features.code
    estimate, result, target = stored.estimate, stored.estimator_result, stored.decision.aim
    estimate.exposure = tick.observation.exposure
    if result.has_imaged_rcm:
        copy_into(estimate.o_c, result.o_c)
        copy_into(estimate.o_c_covariance, result.o_c_covariance)
        estimate.rcm_condition = estimate.rcm_uncertainty = 0.0
        workspace, markers_jacobian = stored.workspace, result.markers_jacobian
        measure_line_features(estimate, markers_jacobian, result.points, target, workspace)
    else:
        filter_weak_directions(tick, result.points)
        copy_into(estimate.J_hat, result.J_hat)
        y, delta = compute_features_and_error(result.points, target, estimate.o_c)
        copy_into(estimate.y, y)
        copy_into(estimate.delta, delta)
    if feature_code == SRD_CODE:
        copy_into(estimate.controlled_jacobian[:3], estimate.J_hat)
        copy_into(estimate.controlled_error[:3], estimate.delta)
    elif feature_code == POINTS_CODE:
        copy_into(estimate.controlled_jacobian[:4], result.markers_jacobian)
        for k in range(4):
            estimate.controlled_error[k] = result.points[k // 2, k % 2] - target[k // 2, k % 2]
    if stored.exploration_state.is_done and estimate.rcm_condition > 0.0:
        monitor, points, thresholds = stored.monitor, estimate.points, tick.parameters.thresholds
        monitor_estimate(monitor, estimate.p1, points, estimate.o_c, estimate.J_hat, thresholds)


@compiled
def measure_line_features(
    estimate: Estimate,
    markers_jacobian: Floats,
    points: Floats,
    target: Floats,
    workspace: Workspace,
) -> None:
    """Compute the features along the line through o_c that passes nearest to both markers, and Ĵ.

    Ĵ follows from `markers_jacobian`, ∂m/∂p₁ (4, 3). If the RCM lies near the plane through the
    camera's centre that is parallel to the image, o_c is very far away. A nearer point in the same
    direction then replaces it. At the target the error is zero about every origin, so that this
    does not move the equilibrium.
    """
    origin, J = limit_origin_distance(estimate.o_c, points, MAX_ORIGIN_DISTANCE_PX), workspace.J_m
    m, m_d = workspace.m, workspace.m_d
    write_shifted_to_rcm(points, origin, m)
    write_shifted_to_rcm(target, origin, m_d)
    write_line_features_jacobian(m, J)
    multiply_into(J, markers_jacobian, estimate.J_hat)
    y, y_d, delta = compute_line_features(m), compute_line_features(m_d), estimate.delta
    estimate.y[0], estimate.y[1], estimate.y[2] = y
    delta[0], delta[1], delta[2] = wrap_angle(y[0] - y_d[0]), y[1] - y_d[1], y[2] - y_d[2]
