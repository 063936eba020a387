"""Normalised flow rule: rule (28) with a gain that does not depend on the speed.

    Ĵ += μ (Δy − Ĵ Δp₁) Δp₁ᵀ / (Δp₁ᵀ Δp₁),    0 < μ < 2

Rule (28) removes the fraction 1 − exp(−γ |Δp₁|²/Δt) of the error along Δp₁: almost nothing in a
slow motion, and all of it in a fast one. After division by |ṗ₁|² the gain is a pure number. The
error of Ĵ along Δp₁ is multiplied by 1 − μ, and no row's error grows for 0 < μ < 2. With μ = 1 it
is Broyden's update, which takes in all of the noise. A smaller μ averages over the newest
displacements of similar direction, and needs more of them.

S. Kaczmarz, Angenäherte Auflösung von Systemen linearer Gleichungen, Bulletin International de
l'Académie Polonaise des Sciences et des Lettres A 35 (1937) 355-357. As an adaptive filter it is
normalised LMS: J. Nagumo and A. Noda, A learning method for system identification, IEEE Trans.
Automatic Control 12 (1967) 282-287.
"""

from dataclasses import dataclass
from typing import Annotated

from rcmservo.constraints import inside
from rcmservo.estimation.displacement import DisplacementEstimator, apply_rank_one_update
from rcmservo.interfaces import Floats


@dataclass(frozen=True)
class NormalisedFlowEstimator(DisplacementEstimator):
    """Estimator of Ĵ by the speed-normalised flow rule (28).

    Each displacement Δp₁ (3,) mm of marker 1 by at least `min_step` changes the features by Δy (3,)
    rad, px, px. It makes the update

        Ĵ += μ (Δy − Ĵ Δp₁) Δp₁ᵀ / |Δp₁|²

    of Ĵ (3, 3) in rad/mm, px/mm, px/mm.

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1, mm, positive.
    mu : float
        Fraction μ of the innovation Δy − Ĵ Δp₁ that an update applies, above 0 and below 2.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    Rule (28) removes the fraction 1 − exp(−γ |Δp₁|²/Δt) of the error of Ĵ along Δp₁ in a time Δt:
    little in a slow motion. Here the fraction is μ at any speed; μ = 1 is Broyden's update. The
    estimator extends the default exploration by one round. It does not predict markers.

    References
    ----------
    Section III-C of the paper; S. Kaczmarz, Angenäherte Auflösung von Systemen linearer
    Gleichungen, Bulletin International de l'Académie Polonaise des Sciences et des Lettres A 35
    (1937) 355-357; J. Nagumo and A. Noda, A learning method for system identification, IEEE Trans.
    Automatic Control 12 (1967) 282-287.
    """

    mu: Annotated[float, inside(0.0, 2.0)] = 0.5

    name = "nflow"
    advice = (
        "a fraction μ (mu) nearer to 1 adapts faster to each displacement, and a smaller min_step "
        "gives more displacements"
    )

    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return apply_rank_one_update(J_hat, delta_p, delta_y, self.mu), P
