"""Latency compensation: the error at the present joints, predicted from the newest frame.

A frame shows the tool at its exposure, while the joints are newer. Since then the joints have moved
marker 1 from p₁(frame) to p₁, which to first order changes the error to

    Δy + Ĵ (p₁ − p₁(frame))

`predict_error` predicts the error of [s r d]. The function `evaluate_controller` of
servo/compute_command.py predicts that of the controlled features, with `predict_component`.
"""

from rcmservo.estimation.base import Estimate
from rcmservo.geometry.features import wrap_angle
from rcmservo.geometry.kinematics import Point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled


@compiled
def predict_component(error: float, slope: Floats, p1_frame: Floats, p1: Point) -> float:
    """Return one component of the error for the present marker 1 at p1 mm.

    Parameters
    ----------
    error : float
        Component in the newest frame.
    slope : Floats
        Its derivative (3,) with respect to p₁, per mm.
    p1_frame : Floats
        Position (3,) of marker 1 at the exposure of this frame, mm.
    p1 : Point
        Present position of marker 1, mm.
    """
    x, y, z = p1_frame[0] - p1[0], p1_frame[1] - p1[1], p1_frame[2] - p1[2]
    return error - (slope[0] * x + slope[1] * y + slope[2] * z)


@compiled
def predict_error(estimate: Estimate, p1: Point) -> None:
    """Predict the error Δy of [s r d] for the present marker 1 at p1 mm, into `predicted_delta`."""
    predicted = estimate.predicted_delta
    for i in range(3):
        predicted[i] = predict_component(estimate.delta[i], estimate.J_hat[i], estimate.p1, p1)
    predicted[0] = wrap_angle(predicted[0])
