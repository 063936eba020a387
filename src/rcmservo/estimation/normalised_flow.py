"""Normalised flow: rule (28) with the speed divided out, so that a displacement teaches the same
share however fast it was made.

    Ĵ += μ (Δy − Ĵ Δp₁) Δp₁ᵀ / (Δp₁ᵀ Δp₁),    0 < μ < 2

(28) learns the share 1 − exp(−γ |Δp₁|²/Δt) of what is new along Δp₁, nothing at a crawl and all of
it in haste. Divided by |ṗ₁|² its gain is a pure number: the error of Ĵ along Δp₁ becomes 1 − μ of
what it was, and no row's error grows for any μ from 0 to 2. μ = 1 is Broyden's update, all of the
noise with all of the news; a smaller μ averages over the last displacements in about the same
direction, and needs more of them.

S. Kaczmarz, Angenäherte Auflösung von Systemen linearer Gleichungen, Bull. Acad. Polon. Sci. Lett.
A 35 (1937) 355-357. As an adaptive filter it is normalised LMS: J. Nagumo and A. Noda, A learning
method for system identification, IEEE Trans. Automatic Control 12 (1967) 282-287.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import inside
from rcmservo.estimation.displacement import ByDisplacements, toward
from rcmservo.interfaces import Floats


@dataclass(frozen=True)
class NormalisedFlowEstimator(ByDisplacements):
    """Ĵ from flow, normalised by the speed. It takes the default exploration a round further.

    Parameters
    ----------
    mu : float
        μ, the share of what is new in a displacement that is learnt from it.
    """

    mu: Annotated[float, inside(0.0, 2.0)] = 0.5

    name = "nflow"
    models = False
    advice = (
        "a share μ (mu) nearer to 1 learns more from each displacement, and a smaller min_step "
        "makes more of them"
    )

    def uncertain(self) -> Floats:
        return np.empty(0)

    def learn(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return toward(J_hat, delta_p, delta_y, self.mu), P
