"""Recursive least squares for Ĵ with exponential forgetting.

`RlsEstimator` states the cost that Ĵ minimises. The recursion takes one displacement at a time,
with P the inverse of Σᵢ λⁿ⁻ⁱ Δpᵢ Δpᵢᵀ + λⁿ I/P₀:

    K = P Δp / (λ + Δpᵀ P Δp),    Ĵ += (Δy − Ĵ Δp) Kᵀ,    P = (P − K Δpᵀ P)/λ

Broyden's update fits the newest displacement alone. This estimator averages noise over the last
1/(1 − λ) displacements, each weighted by its squared length. λ applies to a displacement and not to
a frame, so that a tool at rest forgets nothing.

In a direction without motion, every displacement multiplies the variance in P by 1/λ (windup). The
next displacement in that direction then determines Ĵ there almost alone, with its noise. Once a
variance reaches MAX_VARIANCE_PER_MM2, the whole matrix stops growing: forgetting then stops in all
directions until there is motion in that one.
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
"""Largest variance in P (1/mm²): the displacements hold no information on that direction."""


@dataclass(frozen=True)
class RlsEstimator(DisplacementEstimator):
    """Estimator of Ĵ by recursive least squares with forgetting.

    Displacement i of marker 1, at least `min_step` long, is Δpᵢ (3,) mm; it changes the features by
    Δyᵢ (3,) rad, px, px. After n displacements

        Ĵ = argmin over J of  Σᵢ λⁿ⁻ⁱ |Δyᵢ − J Δpᵢ|² + λⁿ |J|²/P₀,    i = 1 … n

    with rows in rad/mm, px/mm, px/mm and the Frobenius norm of J (3, 3), as long as no variance in
    P reaches 1e9/mm².

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1, mm, positive.
    forgetting : float
        Forgetting factor λ, above 0 and at most 1: each displacement multiplies the weights of the
        earlier ones by λ. With 1 all displacements weigh the same.
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

    P grows by less than 1/λ where a variance in it would exceed 1e9/mm². The default exploration
    motion is long enough for this estimator. The estimator does not predict markers.

    References
    ----------
    K. Hosoda and M. Asada, Versatile visual servoing without knowledge of true Jacobian, IROS 1994:
    their weighting matrix W is P, and their forgetting factor ρ is λ. J. A. Piepmeier, G. V.
    McMurray and H. Lipkin, Uncalibrated dynamic visual servoing, IEEE Trans. Robotics and
    Automation 20 (2004) 143-147.
    """

    forgetting: Annotated[float, FRACTION] = 0.95
    covariance: Annotated[float, between(1e-9, MAX_VARIANCE_PER_MM2, "a number", "1/mm²")] = 100.0

    name = "rls"
    advice = EXPLORATION_ADVICE

    def initial_covariance(self) -> Floats:
        """Return P (3, 3), common to all rows of Ĵ, before the first displacement."""
        return self.covariance * np.eye(3)

    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return apply_rls_update(J_hat, P, delta_p, delta_y, self.forgetting)


@compiled
def inflate_covariance(P: Floats, forgetting: float) -> Floats:
    """Return P (3, 3) 1/mm² multiplied by 1/λ, or by less so that no variance exceeds the maximum.

    The factor is min(1/λ, MAX_VARIANCE_PER_MM2 / largest variance), the same for all directions.
    """
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
    J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats, forgetting: float
) -> tuple[Floats, Floats]:
    """Return Ĵ and P after a displacement Δp that changed the features by Δy.

    The recursion of the module is a Kalman update with the covariance P/λ and the variance R = 1 of
    a feature. `update_covariance` computes it in Joseph's form.

    Parameters
    ----------
    J_hat : array (3, 3)
        Ĵ in rad/mm, px/mm, px/mm.
    P : array (3, 3)
        Covariance in 1/mm².
    delta_p : array (3,)
        Displacement Δp of marker 1, mm.
    delta_y : array (3,)
        Change Δy of the features in rad, px, px.
    forgetting : float
        Forgetting factor λ.

    Returns
    -------
    tuple of array (3, 3)
        Updated Ĵ and P.
    """
    P_inflated = inflate_covariance(P, forgetting)
    K = compute_kalman_gain(P_inflated, delta_p, 1.0)
    return (
        correct_jacobian(J_hat, delta_p, delta_y, K),
        update_covariance(P_inflated, delta_p, 1.0, K),
    )
