"""Recursive least squares: the Ĵ that explains all displacements best, older ones less and less.

    Ĵ = argmin over J of  Σᵢ λⁿ⁻ⁱ |Δyᵢ − J Δpᵢ|² + λⁿ |J|²/P₀,    i = 1 … n

Taken one displacement at a time, with P the inverse of Σᵢ λⁿ⁻ⁱ Δpᵢ Δpᵢᵀ + λⁿ I/P₀,

    K = P Δp / (λ + Δpᵀ P Δp),    Ĵ += (Δy − Ĵ Δp) Kᵀ,    P = (P − K Δpᵀ P)/λ

Where Broyden's update believes the latest displacement alone, this averages noise over the last
1/(1 − λ) of them, each by its length squared. λ is a displacement's, not a frame's: what was learnt
is forgotten by the way that the tool goes, and at rest not at all. In a direction in which it does
not go P grows by 1/λ with every displacement (windup), here to MOST at most; what is learnt there
next is learnt at once, with its noise.

K. Hosoda and M. Asada, Versatile visual servoing without knowledge of true Jacobian, IROS 1994,
whose weighting matrix W is P and whose forgetting factor ρ is λ. J. A. Piepmeier, G. V. McMurray
and H. Lipkin, Uncalibrated dynamic visual servoing, IEEE Trans. Robotics and Automation 20 (2004)
143-147.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import FRACTION, between
from rcmservo.estimation.displacement import (
    LOOK_FURTHER,
    ByDisplacements,
    corrected,
    gain,
    left_uncertain,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled

MOST = 1e9
"""1/mm², that no variance in P exceeds: a direction of which nothing is known."""


@compiled
def aged(P: Floats, forgetting: float) -> Floats:
    """P/λ (3, 3), or less where that exceeds MOST."""
    widest, out = 0.0, np.empty((3, 3))
    for i in range(3):
        widest = max(widest, P[i, i])
    growth = min(1.0 / forgetting, MOST / widest)
    for i in range(3):
        for j in range(3):
            out[i, j] = growth * P[i, j]
    return out


@compiled
def learn(
    J: Floats, P: Floats, delta_p: Floats, delta_y: Floats, forgetting: float
) -> tuple[Floats, Floats]:
    """Ĵ (3, 3) and P (3, 3) 1/mm² after a displacement Δp (3,) mm with the flow Δy (3,)."""
    older = aged(P, forgetting)
    K = gain(older, delta_p, 1.0)
    return corrected(J, delta_p, delta_y, K), left_uncertain(older, delta_p, 1.0, K)


@dataclass(frozen=True)
class RlsEstimator(ByDisplacements):
    """Ĵ by recursive least squares with exponential forgetting. The default exploration is enough
    for it.

    Parameters
    ----------
    forgetting : float
        λ, the weight of a displacement after the next one, from 0 to 1 (nothing is forgotten).
    covariance : float
        P₀, 1/mm²: that Ĵ is zero counts as much as one displacement of 1/√P₀ mm in each direction
        that brought no flow.
    """

    forgetting: Annotated[float, FRACTION] = 0.95
    covariance: Annotated[float, between(1e-9, MOST, "a number", "1/mm²")] = 100.0

    name = "rls"
    models = False
    advice = LOOK_FURTHER

    def uncertain(self) -> Floats:
        return self.covariance * np.eye(3)

    def learn(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return learn(J_hat, P, delta_p, delta_y, self.forgetting)
