"""Broyden's rank-one update of the Jacobian, the alternative to rule (28) that III-C names.

It is the smallest change of Ĵ with which Ĵ Δp₁ = Δy holds for the newest displacement:

    Ĵ += (Δy − Ĵ Δp₁) Δp₁ᵀ / (Δp₁ᵀ Δp₁)

It is the limit of rule (28) for large γ: the error of Ĵ along Δp₁ becomes zero at any speed and
time. The noise of Δy enters Ĵ in full, divided by |Δp₁|. The smallest displacement is therefore
longer than that of the estimators that average.

C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19
(1965) 577-593.
"""

from dataclasses import dataclass
from typing import Annotated

from rcmservo.constraints import positive
from rcmservo.estimation.displacement import DisplacementEstimator, apply_rank_one_update
from rcmservo.interfaces import Floats


@dataclass(frozen=True)
class BroydenEstimator(DisplacementEstimator):
    """Estimator of Ĵ by Broyden's rank-one update.

    Each displacement of marker 1 by at least `min_step`, from p₁ to p₁ + Δp₁ (3,) mm, changes the
    features by Δy (3,) rad, px, px. It makes the update

        Ĵ += (Δy − Ĵ Δp₁) Δp₁ᵀ / |Δp₁|²

    of Ĵ (3, 3) in rad/mm, px/mm, px/mm.

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1 between two updates, mm, positive. A pixel of noise
        changes Ĵ by 1/min_step px/mm.

    Raises
    ------
    BadInput
        If `min_step` is not a positive length.

    Notes
    -----
    It does not average noise, and it does not predict markers.

    References
    ----------
    Section III-C of the paper; C. G. Broyden, Math. Comp. 19 (1965) 577-593.
    """

    min_step: Annotated[float, positive("length in mm")] = 3.0

    name = "broyden"

    def update_jacobian(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        return apply_rank_one_update(J_hat, delta_p, delta_y, 1.0), P
