"""Base of the estimators that update Ĵ by displacements, and the updates that they share.

A displacement (Δp₁, Δy) is the motion of marker 1 between two frames and the change of the features
that it causes. The first frame is the one in which the previous displacement ended. The second is
the first frame in which marker 1 is at least `min_step` away from there. A tool at rest makes no
displacement, so that noise at the target does not change Ĵ.
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
"""Advice to the user of an estimator that weighs a displacement by its length."""


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
    p1: Floats | None = None
    points: Floats | None = None


@dataclass(frozen=True)
class DisplacementEstimator(Estimator):
    """Base of the estimators that update Ĵ by one displacement at a time.

    A subclass implements `update_jacobian`, and `initial_covariance` if it has a covariance.

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1, mm, positive. A pixel of noise changes Ĵ by 1/min_step
        px/mm at most.
    """

    min_step: Annotated[float, positive("length in mm")] = 2.0

    def initial_covariance(self) -> Floats:
        """Return P before the first displacement; empty by default."""
        return np.empty(0)

    @abstractmethod
    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        """Return Ĵ (3, 3) and P after a displacement of marker 1.

        Parameters
        ----------
        J_hat : Floats
            Ĵ (3, 3) in rad/mm, px/mm, px/mm before the displacement.
        P : Floats
            Covariance of the rows of Ĵ before it; empty (0,), and returned unchanged, if the
            estimator has none.
        delta_p : Floats
            Displacement Δp₁ (3,) in mm.
        delta_y : Floats
            Change Δy (3,) of the features in rad, px, px.

        Returns
        -------
        tuple of Floats
            Ĵ and P after the displacement.
        """

    def init(self) -> DisplacementMemory:
        """Return the memory before the first frame: Ĵ = 0 and the initial covariance, if any."""
        return DisplacementMemory(np.zeros((3, 3)), self.initial_covariance())

    def update(self, memory: DisplacementMemory, tool: Tool, sample: Sample) -> DisplacementMemory:
        """Return the memory after one new frame.

        Ĵ changes once marker 1 is `min_step` mm away from its position at the last change.
        """
        if memory.p1 is None or memory.points is None:
            return memory._replace(p1=sample.p1, points=sample.points)
        delta_p, delta_y = measure_displacement(
            memory.p1, memory.points, sample.p1, sample.points, sample.o_c
        )
        if not compute_norm(delta_p) >= self.min_step:
            return memory
        J_hat, P = self.update_jacobian(memory.J_hat, memory.P, delta_p, delta_y)
        return DisplacementMemory(J_hat, P, sample.p1, sample.points)

    def jacobian(self, memory: DisplacementMemory, tool: Tool, sample: Sample) -> Floats:
        """Return the stored Ĵ (3, 3) in rad/mm, px/mm, px/mm."""
        return memory.J_hat


@compiled
def measure_displacement(
    p1_before: Floats, points_before: Floats, p1: Floats, points: Floats, o_c: Floats
) -> tuple[Floats, Floats]:
    """Return Δp₁ (3,) mm and Δy (3,) between two frames with the raw `points` (2, 2) px.

    The features of both frames are taken about the present o_c, so that a change of o_c is not
    mistaken for motion.
    """
    y = compute_features(shift_to_rcm(points, o_c))
    y_before = compute_features(shift_to_rcm(points_before, o_c))
    return subtract(p1, p1_before), compute_feature_error(y, y_before)


@compiled
def apply_rank_one_update(J: Floats, delta_p: Floats, delta_y: Floats, fraction: float) -> Floats:
    """Return J + fraction (Δy − J Δp) Δpᵀ/|Δp|² (3, 3); Δp (3,) mm must not be zero."""
    squared = delta_p[0] ** 2 + delta_p[1] ** 2 + delta_p[2] ** 2
    predicted, updated = multiply_vector(J, delta_p), np.empty(J.shape)
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            updated[i, j] = J[i, j] + fraction / squared * (delta_y[i] - predicted[i]) * delta_p[j]
    return updated


@compiled
def compute_kalman_gain(P: Floats, delta_p: Floats, R: float) -> Floats:
    """Return the gain K = P Δp / (Δpᵀ P Δp + R) (3,) of a flow with the variance R."""
    K, variance = multiply_vector(P, delta_p), R
    for i in range(3):
        variance += delta_p[i] * K[i]
    for i in range(3):
        K[i] /= variance
    return K


@compiled
def correct_jacobian(J: Floats, delta_p: Floats, delta_y: Floats, K: Floats) -> Floats:
    """Return J + (Δy − J Δp) Kᵀ (3, 3)."""
    predicted, corrected = multiply_vector(J, delta_p), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            corrected[i, j] = J[i, j] + (delta_y[i] - predicted[i]) * K[j]
    return corrected


@compiled
def update_covariance(P: Floats, delta_p: Floats, R: float, K: Floats) -> Floats:
    """Return P (3, 3) after an update with the gain K: (I − K Δpᵀ) P (I − K Δpᵀ)ᵀ + R K Kᵀ.

    This is Joseph's form, which stays symmetric and positive definite for any gain.
    """
    factor, factor_times_P, updated = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            factor[i, j] = (1.0 if i == j else 0.0) - K[i] * delta_p[j]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                factor_times_P[i, j] += factor[i, k] * P[k, j]
    for i in range(3):
        for j in range(i + 1):
            total = R * K[i] * K[j]
            for k in range(3):
                total += factor_times_P[i, k] * factor[j, k]
            updated[i, j] = updated[j, i] = total
    return updated
