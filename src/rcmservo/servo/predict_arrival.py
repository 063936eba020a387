"""Prediction of where the tool will stand when the image shows it at the target.

With H = ∂m/∂p₁ (4, 3) of the projection fit at the joints of teaching, the tool will be off the
taught position by

    gap = (HᵀH + λ I)⁻¹ Hᵀ (m_d − h − r̄)    mm

where h (4,) px are the taught markers by the fit, m_d those of the target, and r̄ the present mean
residuals of the markers, which are taken to be the same there. A camera that moved or a marker
that slides changes r̄, so that the gap grows while the tool still moves. Errors of arm and tool
also leave residuals; their rms over the run, in mm, sets λ, which damps directions that the image
hardly shows.
"""

import numpy as np

from rcmservo.estimation.camera_fit import project_markers
from rcmservo.estimation.camera_fit_prediction import (
    compute_image_covariance,
    compute_markers_jacobian,
)
from rcmservo.geometry.kinematics import compute_point_distance, compute_position_tuple
from rcmservo.interfaces import NEVER_NS, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_norm
from rcmservo.numerics.small_solvers import invert
from rcmservo.safety.checks.drift import compute_arm_error
from rcmservo.servo.kernel_parameters import TickContext, make_rcm_struct, make_tool_struct

GAP_MM = 2.3
"""Gap (mm) that is allowed at the target, in addition to noise."""

MAX_WAY_MM = 15.0
"""Distance (mm) from the target beyond which errors of the model may be larger than that."""

GAP_PER_WAY = 0.1
"""Allowed gap per distance that is left to the target."""

GAP_SIGMA_RATIO = 0.5
"""Standard deviations of the gap that are allowed, as a ratio of `max_target_deviation`."""

MAX_ARM_ERROR_MM = 0.19
"""Largest rms residual (mm) that is taken for errors of arm and tool."""

NEAR_MM = 5.0
"""Distance (mm) from the taught position at which the approach ends."""

MIN_SAMPLE_MM = 0.3
"""Motion of marker 1 (mm) between two samples of the residuals."""

TEACHING_FRAMES = 30.0
"""Number of frames that are assumed to be averaged in a target."""


@compiled
def watch_arrival(tick: TickContext) -> bool:
    """Return True if the tool will stop too far from the joints of teaching, for long enough."""
    decision, monitor, thresholds = (
        tick.stored.decision,
        tick.stored.monitor,
        tick.parameters.thresholds,
    )
    now, has_mean = tick.observation.now, monitor.averaged_frames >= thresholds.drift_frames
    if not (tick.stored.exploration_state.is_done and has_mean):
        decision.gap_since = NEVER_NS
        return False
    sample_residuals(tick)
    if not arrives_elsewhere(tick):
        decision.gap_since = NEVER_NS
        return False
    if decision.gap_since == NEVER_NS:
        decision.gap_since = now
    return now - decision.gap_since >= thresholds.target_mismatch_time * 1e9


@compiled
def sample_residuals(tick: TickContext) -> None:
    """Add the mean residuals in mm to their sum of squares, once for each 0.3 mm of the approach.

    Near the target trouble with the picture would count as an error of the arm.
    """
    stored, monitor, rcm = tick.stored, tick.stored.monitor, make_rcm_struct(tick.parameters)
    p1, sampled = stored.estimate.p1, monitor.sampled_p1
    place, before = (p1[0], p1[1], p1[2]), (sampled[0], sampled[1], sampled[2])
    is_near = compute_point_distance(place, compute_position_tuple(rcm, tick.setpoint.q)) < NEAR_MM
    if is_near or compute_point_distance(place, before) < MIN_SAMPLE_MM:
        return
    H = compute_markers_jacobian(stored.projection_fit, p1, make_tool_struct(tick.parameters))
    px_per_mm = max(compute_norm(H[0]), compute_norm(H[1]), 1e-6)
    squared_px = 0.5 * compute_norm(monitor.mean_residual) ** 2
    monitor.residual_sums[0] += squared_px / px_per_mm**2
    monitor.residual_sums[1] += 1.0
    for i in range(3):
        sampled[i] = p1[i]


@compiled
def arrives_elsewhere(tick: TickContext) -> bool:
    """Return True if the predicted gap exceeds what is allowed."""
    stored, setpoint, parameters = tick.stored, tick.setpoint, tick.parameters
    fit, rcm, shaft = (
        stored.projection_fit,
        make_rcm_struct(parameters),
        make_tool_struct(parameters),
    )
    p1_d = compute_position_tuple(rcm, setpoint.q)
    p1 = compute_position_tuple(rcm, tick.observation.q)
    way_mm = compute_point_distance(p1, p1_d)
    if not way_mm <= MAX_WAY_MM:
        return False
    difference = np.empty(4)
    predicted = project_markers(fit, p1_d, shaft)
    for k in range(2):
        for i in range(2):
            h = fit.origin[3 + i] + predicted[k].m[i]
            residual = stored.monitor.mean_residual[k, i]
            difference[2 * k + i] = setpoint.points[k, i] - h - residual
    gap_mm, deviation_mm = solve_gap(tick, difference, p1_d)
    sigmas = GAP_SIGMA_RATIO * parameters.thresholds.max_target_deviation
    allowed_mm = GAP_MM + GAP_PER_WAY * way_mm + sigmas * deviation_mm
    return not gap_mm <= allowed_mm


@compiled
def solve_gap(
    tick: TickContext, difference: Floats, p1_d: tuple[float, float, float]
) -> tuple[float, float]:
    """Return the length of the gap and its standard deviation in mm, inf if not determined."""
    fit, shaft = tick.stored.projection_fit, make_tool_struct(tick.parameters)
    H = compute_markers_jacobian(fit, p1_d, shaft)
    arm_error_mm = min(compute_arm_error(tick.stored.monitor), MAX_ARM_ERROR_MM)
    px_per_mm = max(compute_norm(H[0]), compute_norm(H[1]))
    N = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            N[i, j] = (arm_error_mm * px_per_mm) ** 2 if i == j else 0.0
            for k in range(4):
                N[i, j] += H[k, i] * H[k, j]
    if not invert(N):
        return 0.0, np.inf
    frames = tick.parameters.thresholds.drift_frames
    noise = fit.noise_variance * (1.0 / frames + 1.0 / TEACHING_FRAMES)
    predicted = project_markers(fit, p1_d, shaft)
    gap, variance = 0.0, 0.0
    for i in range(3):
        part = 0.0
        for k in range(2):
            uu, uv, vv = compute_image_covariance(fit, predicted[k])
            per_u, per_v = 0.0, 0.0
            for j in range(3):
                per_u += N[i, j] * H[2 * k, j]
                per_v += N[i, j] * H[2 * k + 1, j]
            part += per_u * difference[2 * k] + per_v * difference[2 * k + 1]
            variance += (uu + noise) * per_u**2 + 2.0 * uv * per_u * per_v
            variance += (vv + noise) * per_v**2
        gap += part**2
    return np.sqrt(gap), np.sqrt(variance)
