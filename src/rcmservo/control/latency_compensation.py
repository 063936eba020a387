"""Latency compensation: the error at the present joints, predicted from the newest frame.

A frame shows the tool as it was at its exposure, and the joints are newer. To first order the error
has changed since by Ĵ times the motion of marker 1 that the joints report.
"""

from rcmservo.estimation.base import Estimate
from rcmservo.geometry.features import wrap_angle
from rcmservo.geometry.kinematics import Point
from rcmservo.numerics.jit import compiled


@compiled
def predict_error(estimate: Estimate, p1: Point) -> None:
    """Predict the error Δy of [s r d] for marker 1 at p1 mm."""
    J, predicted = estimate.J_hat, estimate.predicted_delta
    x, y, z = estimate.p1[0] - p1[0], estimate.p1[1] - p1[1], estimate.p1[2] - p1[2]
    for i in range(3):
        predicted[i] = estimate.delta[i] - (J[i, 0] * x + J[i, 1] * y + J[i, 2] * z)
    predicted[0] = wrap_angle(predicted[0])
