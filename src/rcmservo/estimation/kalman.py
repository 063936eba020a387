"""Kalman's filter on the rows of Ĵ: each is a state that drifts as the tool goes, and every
displacement measures it along one direction.

    x = Ĵᵢ/bᵢ,    x⁺ = x + η,  E[ηηᵀ] = Q = q² |Δp| I,    Δyᵢ/bᵢ = Δpᵀ x + ε,  E[ε²] = R = r²

    P⁻ = P + Q,    K = P⁻ Δp / (Δpᵀ P⁻ Δp + R),    x += K (Δyᵢ/bᵢ − Δpᵀ x),    P by Joseph's form

b = (10°, 10 px, 10 px): in units of it the three features are about as noisy and change about as
fast, so that one q, r and P serve all rows. J changes by the way that the tool goes and not by
time, so Q is in proportion to |Δp|: half a way twice adds what the whole adds, and a tool at rest
neither forgets nor drifts. Without Q, and for any R, it is recursive least squares that forgets
nothing.

J. Qian and J. Su, Online estimation of image Jacobian matrix by Kalman-Bucy filter for uncalibrated
stereo vision feedback, ICRA 2002. A Q that is the same at every frame, as is usual there, would let
a tool at rest forget.
"""

from abc import ABC
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import between
from rcmservo.estimation.displacement import (
    LOOK_FURTHER,
    ByDisplacements,
    corrected,
    gain,
    left_uncertain,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import length


@compiled
def drifted(P: Floats, delta_p: Floats, drift: float) -> Floats:
    """P⁻ = P + q² |Δp| I (3, 3)."""
    out, more = P.copy(), drift**2 * length(delta_p)
    for i in range(3):
        out[i, i] += more
    return out


@compiled
def learn(
    J: Floats, P: Floats, delta_p: Floats, delta_y: Floats, drift: float, noise: float
) -> tuple[Floats, Floats]:
    """Ĵ (3, 3) and P (3, 3) b²/mm² after a displacement Δp (3,) mm with the flow Δy (3,)."""
    before, R = drifted(P, delta_p, drift), noise**2
    K = gain(before, delta_p, R)
    return corrected(J, delta_p, delta_y, K), left_uncertain(before, delta_p, R, K)


@dataclass(frozen=True)
class Drifting(ByDisplacements, ABC):
    """Takes the rows of J for states that drift.

    Parameters
    ----------
    drift : float
        q, what a derivative drifts by in 1 mm of way, one standard deviation in b/mm; it grows with
        the root of the way.
    noise : float
        r, noise of a displacement's flow, one standard deviation in b: 0.05 is half a degree of s
        and half a pixel of r and d.
    spread : float
        Root of P at first, b/mm: how large a derivative is thought to be before anything is seen.
    """

    drift: Annotated[float, between(0.0, 1000.0)] = 0.007
    noise: Annotated[float, between(1e-6, 1000.0)] = 0.05
    spread: Annotated[float, between(1e-6, 1000.0)] = 1.0

    advice = LOOK_FURTHER


@dataclass(frozen=True)
class KalmanEstimator(Drifting):
    """Ĵ by Kalman's filter. The default exploration is enough for it."""

    name = "kalman"
    models = False

    def uncertain(self) -> Floats:
        return self.spread**2 * np.eye(3)

    def learn(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return learn(J_hat, P, delta_p, delta_y, self.drift, self.noise)
