"""Kalman filter by the maximum correntropy criterion, which suppresses outliers.

Least squares weighs an error of 100 σ a hundred times as much as one of 1 σ. Here the square of the
innovation of each row of Ĵ/b (notation of kalman.py),

    ν = Δyᵢ/bᵢ − Δpᵀ x,    S = Δpᵀ P⁻ Δp + R

is replaced by the correntropy kernel, which stops growing beyond some βσ:

    λ = exp(−ν²/(2 β² S)),    K = λ P⁻ Δp / (λ Δpᵀ P⁻ Δp + R),    P by Joseph's form with K and R

R thus counts as R/λ. An innovation of a few σ keeps nearly all of its weight, and one of tens of σ
has none. The more certain Ĵ is in a direction, the smaller an innovation already counts as an
outlier. While displacements are suppressed, P still grows with the path, so that the filter adapts
to a Jacobian that has changed permanently. For β → ∞ it is the Kalman filter.

It is the filter of Izanloo and others with a kernel width proportional to √S. With a fixed width,
the first flow of an empty Ĵ, which is tens of σ from zero if σ² = R, counts as an outlier and Ĵ
stays zero. The fixed-point iteration of Chen and others fails in the same manner if it starts at
the prior. If it starts at the Kalman filter's result, it accepts any outlier where Ĵ is less
certain than the measurement.

R. Izanloo, S. A. Fakoorian, H. Sadoghi Yazdi and D. Simon, Kalman filtering based on the maximum
correntropy criterion in the presence of non-Gaussian noise, CISS 2016. B. Chen, X. Liu, H. Zhao and
J. C. Príncipe, Maximum correntropy Kalman filter, Automatica 76 (2017) 70-77. For image Jacobians:
G. R. Leite, Í. B. Q. de Araújo and A. de M. Martins, Regularized maximum correntropy criterion
Kalman filter for uncalibrated visual servoing in the presence of non-Gaussian feature tracking
noise, Sensors 23 (2023) 8518.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import between
from rcmservo.estimation.displacement import kalman_gain, update_covariance
from rcmservo.estimation.kalman import RandomWalkEstimator, predict_covariance
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into, multiply_vector

MIN_WEIGHT = 1e-20
"""Smallest weight of a displacement."""


@compiled
def correntropy_weight(
    P: Floats, delta_p: Floats, innovation: float, R: float, bandwidth: float
) -> float:
    """Return the weight λ of an innovation of one feature in b."""
    P_delta, S = multiply_vector(P, delta_p), R
    for i in range(3):
        S += delta_p[i] * P_delta[i]
    return max(np.exp(-0.5 * innovation**2 / (bandwidth**2 * S)), MIN_WEIGHT)


@compiled
def correntropy_update(
    J: Floats,
    P: Floats,
    delta_p: Floats,
    delta_y: Floats,
    drift: float,
    noise: float,
    bandwidth: float,
) -> tuple[Floats, Floats]:
    """Return Ĵ (3, 3) and P (3, 3, 3) b²/mm² of its rows after a displacement.

    The displacement is Δp (3,) mm with the flow Δy (3,).
    """
    predicted, R = multiply_vector(J, delta_p), noise**2
    J_after, P_after = J.copy(), np.empty((3, 3, 3))
    for i in range(3):
        P_prior, innovation = predict_covariance(P[i], delta_p, drift), delta_y[i] - predicted[i]
        weight = correntropy_weight(P_prior, delta_p, innovation / FEATURE_SCALE[i], R, bandwidth)
        K = kalman_gain(P_prior, delta_p, R / weight)
        for j in range(3):
            J_after[i, j] += innovation * K[j]
        copy_into(P_after[i], update_covariance(P_prior, delta_p, R, K))
    return J_after, P_after


@dataclass(frozen=True)
class CorrentropyEstimator(RandomWalkEstimator):
    """Estimator of Ĵ by a maximum correntropy Kalman filter.

    It is the Kalman filter on the rows of Ĵ with the measurement noise r²/λ. The weight of an
    innovation ν with the variance S is

        λ = exp(−ν²/(2 β² S))

    Parameters
    ----------
    bandwidth : float
        Width β of the kernel in σ. An innovation far beyond it hardly counts.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    The default exploration is long enough for it. It suppresses outliers of single frames, not an
    error that persists. It has no model of the markers. Further parameters: `drift` q (b/mm per
    root of mm), `noise` r (b) and `initial_std`, root of the initial P (b/mm), of
    `RandomWalkEstimator`; `min_step` (mm), smallest displacement, of `DisplacementEstimator`.

    References
    ----------
    R. Izanloo et al., Kalman filtering based on the maximum correntropy criterion in the presence
    of non-Gaussian noise, CISS 2016; B. Chen et al., Automatica 76 (2017) 70-77; G. R. Leite et
    al., Sensors 23 (2023) 8518.
    """

    bandwidth: Annotated[float, between(0.1, 1e6, "a number of σ")] = 3.0

    name = "correntropy"
    predicts_markers = False

    def initial_covariance(self) -> Floats:
        return np.array([self.initial_std**2 * np.eye(3)] * 3)

    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return correntropy_update(
            J_hat, P, delta_p, delta_y, self.drift, self.noise, self.bandwidth
        )
