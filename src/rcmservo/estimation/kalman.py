"""Kalman filter on the rows of Ĵ, in which each row drifts with the path of the tool.

The state is x = Ĵᵢ/bᵢ, row i of Ĵ in units of bᵢ, with b = (10°, 10 px, 10 px). A displacement Δp
with the change Δy of the features measures it along one direction:

    drift:         x⁺ = x + η,              E[ηηᵀ] = Q = q² |Δp| I
    measurement:   Δyᵢ/bᵢ = Δpᵀ x + ε,      E[ε²] = R = r²
    update:        P⁻ = P + Q,    K = P⁻ Δp / (Δpᵀ P⁻ Δp + R),    x += K (Δyᵢ/bᵢ − Δpᵀ x)

P follows by Joseph's form. In units of b the three features have about the same noise and rate of
change, so that one q, r and P serve all rows. J changes with the path of the tool and not with
time. Q is therefore proportional to |Δp|: two half paths add as much as the whole path, and a tool
at rest adds nothing. Without Q, for any R, the filter is recursive least squares without
forgetting.

J. Qian and J. Su, Online estimation of image Jacobian matrix by Kalman-Bucy filter for uncalibrated
stereo vision feedback, ICRA 2002. Their Q is the same at every frame, with which a tool at rest
would forget.
"""

from abc import ABC
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import between
from rcmservo.estimation.displacement import (
    EXPLORATION_ADVICE,
    DisplacementEstimator,
    compute_kalman_gain,
    correct_jacobian,
    update_covariance,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_norm


@dataclass(frozen=True)
class RandomWalkEstimator(DisplacementEstimator, ABC):
    """Base of the estimators that model each row of J as a random walk.

    The unit b of a feature is 10° for the angle s, and 10 px for the distances r and d.

    Parameters
    ----------
    drift : float
        Drift q of a derivative over a path of 1 mm, one standard deviation in b/mm, from 0 to 1000.
        It grows with the square root of the path.
    noise : float
        Noise r of the features' change over a displacement, one standard deviation in b, from 1e-6
        to 1000. 0.05 is half a degree of s, and half a pixel of r and d.
    initial_std : float
        Square root of the initial P in b/mm, from 1e-6 to 1000: expected size of a derivative
        before the first measurement.
    """

    drift: Annotated[float, between(0.0, 1000.0)] = 0.007
    noise: Annotated[float, between(1e-6, 1000.0)] = 0.05
    initial_std: Annotated[float, between(1e-6, 1000.0)] = 1.0

    advice = EXPLORATION_ADVICE


@dataclass(frozen=True)
class KalmanEstimator(RandomWalkEstimator):
    """Estimator of Ĵ by a Kalman filter on its rows.

    The state of a row is x = Ĵᵢ/bᵢ (3,) per mm, with b = (10°, 10 px, 10 px). The three rows share
    one covariance P (3, 3) in b²/mm². Each displacement Δp (3,) mm of marker 1 by at least
    `min_step`, which changes feature i by Δyᵢ, updates x and P with the gain K (3,) in 1/mm:

        P⁻ = P + q² |Δp| I,    K = P⁻ Δp / (Δpᵀ P⁻ Δp + r²),    x += K (Δyᵢ/bᵢ − Δpᵀ x)
        P = (I − K Δpᵀ) P⁻ (I − K Δpᵀ)ᵀ + r² K Kᵀ

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1, mm, positive.
    drift : float
        Drift q of a derivative over a path of 1 mm, one standard deviation in b/mm, from 0 to 1000.
        It grows with the square root of the path.
    noise : float
        Noise r of the features' change over a displacement, one standard deviation in b, from 1e-6
        to 1000. 0.05 is half a degree of s, and half a pixel of r and d.
    initial_std : float
        Square root of the initial P in b/mm, from 1e-6 to 1000: expected size of a derivative
        before the first measurement.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    The default exploration is long enough for it. It does not reject outliers of the markers, and
    it does not predict markers.

    References
    ----------
    J. Qian and J. Su, Online estimation of image Jacobian matrix by Kalman-Bucy filter for
    uncalibrated stereo vision feedback, ICRA 2002. Their covariance of the drift is the same at
    every frame; here it is q² |Δp| I, so that a tool at rest forgets nothing.
    """

    name = "kalman"

    def initial_covariance(self) -> Floats:
        """Return P (3, 3), common to all rows of Ĵ, before the first displacement."""
        return self.initial_std**2 * np.eye(3)

    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return apply_kalman_update(J_hat, P, delta_p, delta_y, self.drift, self.noise)


@compiled
def predict_covariance(P: Floats, delta_p: Floats, drift: float) -> Floats:
    """Return P⁻ = P + q² |Δp| I (3, 3)."""
    predicted, growth = P.copy(), drift**2 * compute_norm(delta_p)
    for i in range(3):
        predicted[i, i] += growth
    return predicted


@compiled
def apply_kalman_update(
    J: Floats, P: Floats, delta_p: Floats, delta_y: Floats, drift: float, noise: float
) -> tuple[Floats, Floats]:
    """Return Ĵ (3, 3) and P (3, 3) b²/mm² after a displacement Δp (3,) mm that changed y by Δy."""
    P_prior, R = predict_covariance(P, delta_p, drift), noise**2
    K = compute_kalman_gain(P_prior, delta_p, R)
    return correct_jacobian(J, delta_p, delta_y, K), update_covariance(P_prior, delta_p, R, K)
