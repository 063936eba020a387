"""Recursive least squares for Ĵ with exponential forgetting.

    Ĵ = argmin over J of  Σᵢ λⁿ⁻ⁱ |Δyᵢ − J Δpᵢ|² + λⁿ |J|²/P₀,    i = 1 … n

The recursion takes one displacement at a time, with P the inverse of Σᵢ λⁿ⁻ⁱ Δpᵢ Δpᵢᵀ + λⁿ I/P₀:

    K = P Δp / (λ + Δpᵀ P Δp),    Ĵ += (Δy − Ĵ Δp) Kᵀ,    P = (P − K Δpᵀ P)/λ

Broyden's update fits the newest displacement alone. This estimator averages noise over the last
1/(1 − λ) displacements, each weighted by its squared length. λ applies to a displacement and not to
a frame, so that a tool at rest forgets nothing. In a direction without motion, P grows by 1/λ with
every displacement (windup), up to MAX_VARIANCE_PER_MM2. The next displacement in that direction
then determines Ĵ alone, with its noise.

K. Hosoda and M. Asada, Versatile visual servoing without knowledge of true Jacobian, IROS 1994:
their weighting matrix W is P, and their forgetting factor ρ is λ. J. A. Piepmeier, G. V. McMurray
and H. Lipkin, Uncalibrated dynamic visual servoing, IEEE Trans. Robotics and Automation 20 (2004)
143-147.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import FRACTION, between
from rcmservo.estimation.displacement import (
    EXPLORATION_ADVICE,
    DisplacementEstimator,
    compute_kalman_gain,
    correct_jacobian,
    update_covariance,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled

MAX_VARIANCE_PER_MM2 = 1e9
"""Largest variance in P (1/mm²), which stands for a direction without any information."""


@dataclass(frozen=True)
class RlsEstimator(DisplacementEstimator):
    """Estimator of Ĵ by recursive least squares with forgetting.

    Displacement i of marker 1 by at least `min_step` is Δpᵢ (3,) mm; it changes the features by Δyᵢ
    (3,) rad, px, px. After n displacements Ĵ (3, 3) in rad/mm, px/mm, px/mm minimises

        Σᵢ λⁿ⁻ⁱ |Δyᵢ − J Δpᵢ|² + λⁿ |J|²/P₀

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1, mm, positive.
    forgetting : float
        Forgetting factor λ, above 0 and at most 1: factor of a displacement's weight at each later
        displacement. 1 forgets nothing.
    covariance : float
        Initial covariance P₀ in 1/mm², from 1e-9 to 1e9. The prior Ĵ = 0 weighs as much as one
        displacement of 1/√P₀ mm in each direction that does not change the features.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    Each displacement makes one step of the recursion, with P (3, 3) in 1/mm², at first P₀ I:

        P⁻ = P/λ,    K = P⁻ Δp / (1 + Δpᵀ P⁻ Δp),    Ĵ += (Δy − Ĵ Δp) Kᵀ
        P = (I − K Δpᵀ) P⁻ (I − K Δpᵀ)ᵀ + K Kᵀ

    P grows by less than 1/λ where a variance in it would exceed 1e9/mm². The default exploration is
    long enough for the estimator. It does not predict markers.

    References
    ----------
    K. Hosoda and M. Asada, Versatile visual servoing without knowledge of true Jacobian, IROS 1994;
    J. A. Piepmeier, G. V. McMurray and H. Lipkin, IEEE Trans. Robotics and Automation 20 (2004)
    143-147.
    """

    forgetting: Annotated[float, FRACTION] = 0.95
    covariance: Annotated[float, between(1e-9, MAX_VARIANCE_PER_MM2, "a number", "1/mm²")] = 100.0

    name = "rls"
    advice = EXPLORATION_ADVICE

    def initial_covariance(self) -> Floats:
        return self.covariance * np.eye(3)

    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return apply_rls_update(J_hat, P, delta_p, delta_y, self.forgetting)


@compiled
def inflate_covariance(P: Floats, forgetting: float) -> Floats:
    """Return P/λ (3, 3), with a smaller factor if a variance would exceed MAX_VARIANCE_PER_MM2."""
    largest_variance, inflated = 0.0, np.empty((3, 3))
    for i in range(3):
        largest_variance = max(largest_variance, P[i, i])
    growth = min(1.0 / forgetting, MAX_VARIANCE_PER_MM2 / largest_variance)
    for i in range(3):
        for j in range(3):
            inflated[i, j] = growth * P[i, j]
    return inflated


@compiled
def apply_rls_update(
    J: Floats, P: Floats, delta_p: Floats, delta_y: Floats, forgetting: float
) -> tuple[Floats, Floats]:
    """Return Ĵ (3, 3) and P (3, 3) 1/mm² after a displacement Δp (3,) mm that changed y by Δy."""
    P_inflated = inflate_covariance(P, forgetting)
    K = compute_kalman_gain(P_inflated, delta_p, 1.0)
    return correct_jacobian(J, delta_p, delta_y, K), update_covariance(P_inflated, delta_p, 1.0, K)
