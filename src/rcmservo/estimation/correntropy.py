"""Kalman's filter by maximum correntropy: a displacement that is far off what all others say hardly
counts.

Least squares gives an error of 100 σ a hundred times the pull of one of 1 σ. Here, for each row of
Ĵ/b and in the terms of Kalman's filter (kalman.py), the squares of what is new,

    ν = Δyᵢ/bᵢ − Δpᵀ x,    S = Δpᵀ P⁻ Δp + R

are replaced by the kernel of correntropy, which no longer grows beyond some βσ:

    λ = exp(−ν²/(2 β² S)),    K = λ P⁻ Δp / (λ Δpᵀ P⁻ Δp + R),    P by Joseph's form with K and R

So R counts as R/λ: what is off by a few σ is believed nearly as ever, and what is off by tens of
them not at all. The more certain Ĵ is of a direction, the less it takes to be an outlier there;
while one is left out, P grows by the way as ever, so that a Jacobian that has changed for good is
learnt anew. For β → ∞ it is Kalman's filter.

This is the filter of Izanloo and others with a kernel whose width goes with S. A width that stays
the same takes the first flow of an empty Ĵ, tens of σ from zero if σ² = R, for an outlier, and
never learns; so does the fixed point of Chen and others, begun at what was known. Begun where
Kalman's filter ends, it lets any outlier pass where Ĵ is less certain than the measurement.

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
from rcmservo.estimation.displacement import gain, left_uncertain
from rcmservo.estimation.kalman import Drifting, drifted
from rcmservo.geometry.features import SCALE
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import product, put

FAINTEST = 1e-20
"""The least weight of a displacement."""


@compiled
def weight(P: Floats, delta_p: Floats, new: float, R: float, bandwidth: float) -> float:
    """λ of what is new in one feature, in b."""
    spread, S = product(P, delta_p), R
    for i in range(3):
        S += delta_p[i] * spread[i]
    return max(np.exp(-0.5 * new**2 / (bandwidth**2 * S)), FAINTEST)


@compiled
def learn(
    J: Floats,
    P: Floats,
    delta_p: Floats,
    delta_y: Floats,
    drift: float,
    noise: float,
    bandwidth: float,
) -> tuple[Floats, Floats]:
    """Ĵ (3, 3) and P (3, 3, 3) b²/mm², of each row, after a displacement Δp (3,) mm with the flow
    Δy (3,).
    """
    foretold, R = product(J, delta_p), noise**2
    J_after, P_after = J.copy(), np.empty((3, 3, 3))
    for i in range(3):
        before, new = drifted(P[i], delta_p, drift), delta_y[i] - foretold[i]
        K = gain(before, delta_p, R / weight(before, delta_p, new / SCALE[i], R, bandwidth))
        for j in range(3):
            J_after[i, j] += new * K[j]
        put(P_after[i], left_uncertain(before, delta_p, R, K))
    return J_after, P_after


@dataclass(frozen=True)
class CorrentropyEstimator(Drifting):
    """Ĵ by Kalman's filter with maximum correntropy. Outliers do not lead it astray. The default
    exploration is enough for it.

    Parameters
    ----------
    bandwidth : float
        β, width of the kernel in σ: errors far beyond it hardly count.
    """

    bandwidth: Annotated[float, between(0.1, 1e6, "a number of σ")] = 3.0

    name = "correntropy"
    models = False

    def uncertain(self) -> Floats:
        return np.array([self.spread**2 * np.eye(3)] * 3)

    def learn(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return learn(J_hat, P, delta_p, delta_y, self.drift, self.noise, self.bandwidth)
