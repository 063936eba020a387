"""Kalman filter by the maximum correntropy criterion, which suppresses outliers.

Correntropy is a measure of similarity that hardly depends on large errors. The filter is that of
kalman.py with the state x = Ĵᵢ/bᵢ, except that the innovation ν with the variance S,

    ν = Δyᵢ/bᵢ − Δpᵀ x,    S = Δpᵀ P⁻ Δp + R

has a weight λ, which falls to zero as |ν| exceeds β standard deviations:

    λ = exp(−ν²/(2 β² S)),    K = λ P⁻ Δp / (λ Δpᵀ P⁻ Δp + R),    P by Joseph's form with K and R

R thus counts as R/λ. An innovation of a few σ keeps nearly all of its weight, and one of tens of σ
has none. The more certain Ĵ is in a direction, the smaller an innovation already counts as an
outlier. While displacements are suppressed, P still grows with the path, so that the filter adapts
to a Jacobian that has changed permanently. For β → ∞ it is the Kalman filter.

It is the filter of Izanloo and others with a kernel width proportional to √S. With the fixed width
of these authors, Ĵ = 0 would stay: the first displacement differs from it by tens of σ and would
count as an outlier. The fixed-point iteration of Chen and others fails in the same manner if it
starts at the prior. If it starts at the Kalman filter's result, it accepts any outlier in a
direction in which Ĵ is less certain than the measurement.

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
from rcmservo.estimation.displacement import compute_kalman_gain, update_covariance
from rcmservo.estimation.kalman import RandomWalkEstimator, predict_covariance
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into, multiply_vector

MIN_WEIGHT = 1e-20
"""Smallest weight λ of a displacement, so that R/λ stays finite."""


@dataclass(frozen=True)
class CorrentropyEstimator(RandomWalkEstimator):
    """Estimator of Ĵ by a maximum correntropy Kalman filter.

    It is a Kalman filter with the state x = Ĵᵢ/bᵢ (3,) per mm, row i of Ĵ in units of b = (10°,
    10 px, 10 px). Each row has its own covariance P (3, 3) in b²/mm², because its weight λ is its
    own. A displacement Δp (3,) mm of marker 1 that changes feature i by Δyᵢ gives

        P⁻ = P + q² |Δp| I,    ν = Δyᵢ/bᵢ − Δpᵀ x,    S = Δpᵀ P⁻ Δp + r²
        λ = exp(−ν²/(2 β² S)),    K = P⁻ Δp / (Δpᵀ P⁻ Δp + r²/λ),    x += K ν
        P = (I − K Δpᵀ) P⁻ (I − K Δpᵀ)ᵀ + r² K Kᵀ

    The weight λ of an innovation ν falls from 1 to 0 as |ν| exceeds β √S.

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
    bandwidth : float
        Width β of the weight in standard deviations √S, from 0.1 to 1e6. An innovation far beyond
        it hardly counts.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    The default exploration is long enough for it. It suppresses outliers of single frames, not an
    error that persists. It does not predict markers. Unlike the fixed kernel width of Izanloo et
    al., the width β √S follows the certainty of Ĵ: with a fixed one, Ĵ = 0 would stay.

    References
    ----------
    R. Izanloo et al., Kalman filtering based on the maximum correntropy criterion in the presence
    of non-Gaussian noise, CISS 2016; B. Chen et al., Automatica 76 (2017) 70-77; G. R. Leite et
    al., Sensors 23 (2023) 8518.
    """

    bandwidth: Annotated[float, between(0.1, 1e6, "a number of σ")] = 3.0

    name = "correntropy"

    def initial_covariance(self) -> Floats:
        """Return P (3, 3, 3), one matrix for each row of Ĵ, before the first displacement."""
        return np.array([self.initial_std**2 * np.eye(3)] * 3)

    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return apply_correntropy_update(
            J_hat, P, delta_p, delta_y, self.drift, self.noise, self.bandwidth
        )


@compiled
def compute_correntropy_weight(
    P: Floats, delta_p: Floats, innovation: float, R: float, bandwidth: float
) -> float:
    """Return the weight λ of an innovation of one feature, in units of b."""
    P_delta, S = multiply_vector(P, delta_p), R
    for i in range(3):
        S += delta_p[i] * P_delta[i]
    return max(np.exp(-0.5 * innovation**2 / (bandwidth**2 * S)), MIN_WEIGHT)


@compiled
def apply_correntropy_update(
    J: Floats,
    P: Floats,
    delta_p: Floats,
    delta_y: Floats,
    drift: float,
    noise: float,
    bandwidth: float,
) -> tuple[Floats, Floats]:
    """Return Ĵ (3, 3) and P (3, 3, 3) b²/mm² of its rows after a displacement.

    The displacement of marker 1 is Δp (3,) mm; it changed the features by Δy (3,).
    """
    predicted, R = multiply_vector(J, delta_p), noise**2
    J_after, P_after = J.copy(), np.empty((3, 3, 3))
    for i in range(3):
        P_prior, innovation = predict_covariance(P[i], delta_p, drift), delta_y[i] - predicted[i]
        weight = compute_correntropy_weight(
            P_prior, delta_p, innovation / FEATURE_SCALE[i], R, bandwidth
        )
        K = compute_kalman_gain(P_prior, delta_p, R / weight)
        for j in range(3):
            J_after[i, j] += innovation * K[j]
        copy_into(P_after[i], update_covariance(P_prior, delta_p, R, K))
    return J_after, P_after
