"""Kalman filter by the maximum correntropy criterion, which suppresses outliers.

Correntropy is a measure of similarity that hardly depends on large errors. The filter is that of
kalman.py with the state x = Ĵᵢ/bᵢ, except that the innovation ν has a weight λ, which falls to zero
as |ν| exceeds the kernel width w:

    ν = Δyᵢ/bᵢ − Δpᵀ x,    λ = exp(−ν²/(2 w²)),    K = λ P⁻ Δp / (λ Δpᵀ P⁻ Δp + R)

P follows by Joseph's form with K and R; R thus counts as R/λ. While displacements are suppressed, P
still grows with the path, so that the filter adapts to a Jacobian that has changed permanently. For
w → ∞ it is the Kalman filter.

The kernel width is fixed, as in the filter of Izanloo and others. A width proportional to the
standard deviation of the innovation locks in: a first displacement that is wrong is accepted, makes
the filter certain, and the right ones then count as outliers. With w = b (10°, 10 px) an empty
estimate adapts as long as a displacement changes the features by little more than w.

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

        P⁻ = P + q² |Δp| I,    ν = Δyᵢ/bᵢ − Δpᵀ x,    λ = exp(−ν²/(2 w²))
        K = P⁻ Δp / (Δpᵀ P⁻ Δp + r²/λ),    x += K ν
        P = (I − K Δpᵀ) P⁻ (I − K Δpᵀ)ᵀ + r² K Kᵀ

    The weight λ of an innovation ν falls from 1 to 0 as |ν| exceeds w.

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1, mm, positive.
    drift : float
        Drift q of a derivative over a path of 1 mm, one standard deviation in b/mm, from 0 to 1000.
        It grows with the square root of the path.
    noise : float
        Noise r of the features' change over a displacement, one standard deviation in b, from 1e-6
        to 1000. 0.1 is a degree of s, and a pixel of r and d.
    initial_std : float
        Square root of the initial P in b/mm, from 1e-6 to 1000: expected size of a derivative
        before the first measurement.
    bandwidth : float
        Kernel width w in b, from 0.1 to 1e6. An innovation far beyond it hardly counts: 1 is 10° of
        s, and 10 px of r and d.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    The default exploration is long enough for it. It suppresses outliers of single frames, not an
    error that persists. It does not predict markers. If a displacement changes a feature by several
    times w, as with a large ``min_step`` near the camera, an empty estimate takes long to adapt.

    References
    ----------
    R. Izanloo et al., Kalman filtering based on the maximum correntropy criterion in the presence
    of non-Gaussian noise, CISS 2016; B. Chen et al., Automatica 76 (2017) 70-77; G. R. Leite et
    al., Sensors 23 (2023) 8518.
    """

    noise: Annotated[float, between(1e-6, 1000.0)] = 0.1
    bandwidth: Annotated[float, between(0.1, 1e6, "a kernel width in b")] = 1.0

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
def compute_correntropy_weight(innovation: float, bandwidth: float) -> float:
    """Return the weight λ of an innovation of one feature; both arguments are in units of b."""
    return max(np.exp(-0.5 * (innovation / bandwidth) ** 2), MIN_WEIGHT)


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
        weight = compute_correntropy_weight(innovation / FEATURE_SCALE[i], bandwidth)
        K = compute_kalman_gain(P_prior, delta_p, R / weight)
        for j in range(3):
            J_after[i, j] += innovation * K[j]
        copy_into(P_after[i], update_covariance(P_prior, delta_p, R, K))
    return J_after, P_after
