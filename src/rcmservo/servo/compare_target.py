"""Comparison of a target's pixels with its joints, as soon as the projection fit predicts them.

The joints of teaching give the positions of both markers at the target, eq. (2), and the fit their
pixels there. A mirrored or zoomed image, a marker that was mistaken while teaching, another tool or
a moved camera contradict the taught pixels before the tool has moved towards them.
"""

import numpy as np

from rcmservo.estimation.camera_fit import project_markers
from rcmservo.estimation.camera_fit_prediction import compute_image_covariance
from rcmservo.geometry.kinematics import compute_position_tuple
from rcmservo.numerics.jit import compiled
from rcmservo.safety.innovation import squared_mahalanobis_distance
from rcmservo.servo.kernel_parameters import TickContext, make_rcm_struct, make_tool_struct


@compiled
def compare_target_with_fit(tick: TickContext) -> None:
    """Record whether the fit contradicts a taught marker at the joints of teaching.

    Without these joints nothing contradicts it.
    """
    stored, setpoint, parameters = tick.stored, tick.setpoint, tick.parameters
    stored.decision.is_implausible = False
    if not stored.exploration_state.is_done or np.isnan(setpoint.q[0]):
        return
    fit, thresholds = stored.projection_fit, parameters.thresholds
    q_d = (setpoint.q[0], setpoint.q[1], setpoint.q[2])
    p1_d = compute_position_tuple(make_rcm_struct(parameters), q_d)
    predicted = project_markers(fit, p1_d, make_tool_struct(parameters))
    for k in range(2):
        u, v = fit.origin[3] + predicted[k].m[0], fit.origin[4] + predicted[k].m[1]
        stored.decision.predicted_target[k, 0], stored.decision.predicted_target[k, 1] = u, v
        error_u, error_v = setpoint.points[k, 0] - u, setpoint.points[k, 1] - v
        error_px = np.sqrt(error_u * error_u + error_v * error_v)
        present = stored.estimate.points[k]
        motion_px = np.sqrt((u - present[0]) ** 2 + (v - present[1]) ** 2)
        allowed_px = thresholds.model_error + thresholds.target_error_fraction * motion_px
        fraction = max(1.0 - allowed_px / error_px, 0.0) if error_px > 0.0 else 0.0
        covariance = compute_image_covariance(fit, predicted[k])
        squared = squared_mahalanobis_distance(error_u, error_v, covariance, fit.noise_variance)
        is_explained = fraction * fraction * squared <= thresholds.max_target_deviation**2
        if not is_explained:
            stored.decision.is_implausible = True
