"""Common base of the estimators that update Ĵ by displacements.

A displacement (Δp₁, Δy) begins at the end of the previous one. It ends in the first frame in which
marker 1 is `min_step` away from there. A tool at rest makes no displacement, so that noise at the
target does not change Ĵ. The features of both ends are taken about one imaged RCM, so that a change
of o_c is not flow.

A row of Ĵ holds the derivatives of one feature with respect to p₁; P (3, 3) is its covariance.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from rcmservo.constraints import positive
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.geometry.features import compute_feature_error, compute_features, shift_to_rcm
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_norm, multiply_vector, subtract

EXPLORATION_ADVICE = (
    "a longer exploration motion (exploration.max_leg_length, exploration.leg_time) raises each "
    "displacement above the noise"
)
"""Advice for estimators that weigh a displacement by its length."""


@compiled
def measure_displacement(
    p1_before: Floats,
    points_before: Floats,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    min_step: float,
) -> tuple[Floats, Floats, bool]:
    """Return Δp₁ (3,) mm, Δy (3,), and whether |Δp₁| is at least min_step.

    Δy is the change of the features from `points_before` (2, 2) to `points` (2, 2), both in raw px.
    """
    delta_p = subtract(p1, p1_before)
    delta_y = compute_feature_error(
        compute_features(shift_to_rcm(points, o_c)),
        compute_features(shift_to_rcm(points_before, o_c)),
    )
    return delta_p, delta_y, compute_norm(delta_p) >= min_step


@compiled
def kalman_gain(P: Floats, delta_p: Floats, R: float) -> Floats:
    """Return the gain K = P Δp / (Δpᵀ P Δp + R) (3,) of a flow with the variance R."""
    K, variance = multiply_vector(P, delta_p), R
    for i in range(3):
        variance += delta_p[i] * K[i]
    for i in range(3):
        K[i] /= variance
    return K


@compiled
def update_covariance(P: Floats, delta_p: Floats, R: float, K: Floats) -> Floats:
    """Return P (3, 3) after an update with the gain K: (I − K Δpᵀ) P (I − K Δpᵀ)ᵀ + R K Kᵀ.

    This is Joseph's form, which stays symmetric and positive definite for any gain.
    """
    factor, product_left, out = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            factor[i, j] = (1.0 if i == j else 0.0) - K[i] * delta_p[j]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                product_left[i, j] += factor[i, k] * P[k, j]
    for i in range(3):
        for j in range(i + 1):
            total = R * K[i] * K[j]
            for k in range(3):
                total += product_left[i, k] * factor[j, k]
            out[i, j] = out[j, i] = total
    return out


@compiled
def correct_jacobian(J: Floats, delta_p: Floats, delta_y: Floats, K: Floats) -> Floats:
    """Return Ĵ + (Δy − Ĵ Δp) Kᵀ (3, 3)."""
    predicted, out = multiply_vector(J, delta_p), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = J[i, j] + (delta_y[i] - predicted[i]) * K[j]
    return out


class DisplacementMemory(NamedTuple):
    """Ĵ and the frame in which the newest displacement ended.

    Parameters
    ----------
    J_hat : Floats
        Ĵ (3, 3) in rad/mm, px/mm, px/mm; zeros before the first displacement.
    P : Floats
        Covariance of the rows of Ĵ: (3, 3) common to all rows, (3, 3, 3) one for each row, or empty
        (0,) if the estimator has none.
    p1 : Floats or None
        p₁ (3,) mm in that frame; None before the first frame.
    points : Floats or None
        Markers (2, 2) in raw px of that frame; None before the first frame.
    """

    J_hat: Floats
    P: Floats
    p1: Floats | None
    points: Floats | None


@dataclass(frozen=True)
class DisplacementEstimator(Estimator):
    """Base of the estimators that update Ĵ by one displacement at a time.

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1, mm. A pixel of noise is 1/min_step px/mm of it.
    """

    min_step: Annotated[float, positive("length in mm")] = 2.0

    @abstractmethod
    def initial_covariance(self) -> Floats:
        """Return P before the first displacement."""

    @abstractmethod
    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        """Return Ĵ (3, 3) and P after a displacement Δp (3,) mm with the flow Δy (3,)."""

    def init(self) -> DisplacementMemory:
        return DisplacementMemory(np.zeros((3, 3)), self.initial_covariance(), None, None)

    def update(self, memory: DisplacementMemory, tool: Tool, sample: Sample) -> DisplacementMemory:
        if memory.p1 is None or memory.points is None:
            return memory._replace(p1=sample.p1, points=sample.points)
        delta_p, delta_y, is_long = measure_displacement(
            memory.p1, memory.points, sample.p1, sample.points, sample.o_c, self.min_step
        )
        if not is_long:
            return memory
        J_hat, P = self.update_jacobian(memory.J_hat, memory.P, delta_p, delta_y)
        return DisplacementMemory(J_hat, P, sample.p1, sample.points)

    def jacobian(self, memory: DisplacementMemory, tool: Tool, sample: Sample) -> Floats:
        return memory.J_hat


@compiled
def rank_one_update(J: Floats, delta_p: Floats, delta_y: Floats, fraction: float) -> Floats:
    """Return J + fraction (Δy − J Δp) Δpᵀ/|Δp|² (3, 3); Δp (3,) mm must not be zero."""
    squared = delta_p[0] ** 2 + delta_p[1] ** 2 + delta_p[2] ** 2
    predicted, out = multiply_vector(J, delta_p), np.empty(J.shape)
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            out[i, j] = J[i, j] + fraction / squared * (delta_y[i] - predicted[i]) * delta_p[j]
    return out
