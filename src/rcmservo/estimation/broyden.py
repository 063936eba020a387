"""Broyden's rank-one update of the Jacobian, the alternative to rule (28) that III-C names.

It is the smallest change of Ĵ with which Ĵ Δp₁ = Δy holds for the newest displacement:

    Ĵ += (Δy − Ĵ Δp₁) Δp₁ᵀ / (Δp₁ᵀ Δp₁)

It is the limit of rule (28) for large γ: the error of Ĵ along Δp₁ becomes zero at any speed and
time. The noise of Δy enters Ĵ in full, divided by |Δp₁|. An update therefore waits until marker 1
is `min_step` away from the position of the previous update.

C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19
(1965) 577-593.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from rcmservo.constraints import positive
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.displacement import rank_one_update
from rcmservo.geometry.features import compute_feature_error, compute_features, shift_to_rcm
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_norm, subtract


@compiled
def broyden_update(J: Floats, delta_p: Floats, delta_y: Floats) -> Floats:
    """Return the Ĵ (3, 3) closest to J that maps Δp (3,) mm, not zero, to Δy (3,)."""
    return rank_one_update(J, delta_p, delta_y, 1.0)


@compiled
def update_from_frame(
    J: Floats,
    p1_before: Floats,
    points_before: Floats,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    min_step: float,
) -> tuple[Floats, bool]:
    """Return Ĵ after a new frame, and whether p₁ has moved far enough for an update.

    The features of both frames are taken about the present o_c.
    """
    delta_p = subtract(p1, p1_before)
    if not compute_norm(delta_p) >= min_step:
        return J.copy(), False
    delta_y = compute_feature_error(
        compute_features(shift_to_rcm(points, o_c)),
        compute_features(shift_to_rcm(points_before, o_c)),
    )
    return broyden_update(J, delta_p, delta_y), True


class BroydenMemory(NamedTuple):
    """Ĵ and the frame of its newest update.

    Parameters
    ----------
    J_hat : Floats
        Ĵ (3, 3) in rad/mm, px/mm, px/mm; zeros before the first update.
    p1 : Floats or None
        p₁ (3,) mm at the newest update, or in the first frame; None before the first frame.
    points : Floats or None
        Markers (2, 2) in raw px of that frame; None before the first frame.
    """

    J_hat: Floats
    p1: Floats | None
    points: Floats | None


@dataclass(frozen=True)
class BroydenEstimator(Estimator):
    """Estimator of Ĵ by Broyden's rank-one update.

    Each displacement of marker 1 by at least `min_step` makes the update

        Ĵ += (Δy − Ĵ Δp₁) Δp₁ᵀ / |Δp₁|²

    Parameters
    ----------
    min_step : float
        Smallest displacement of marker 1 between two updates, mm. A pixel of noise changes Ĵ by
        1/min_step px/mm.

    Raises
    ------
    BadInput
        If `min_step` is not a positive length.

    Notes
    -----
    It does not average noise, and it has no model of the markers.

    References
    ----------
    Section III-C of the paper; C. G. Broyden, Math. Comp. 19 (1965) 577-593.
    """

    min_step: Annotated[float, positive("length in mm")] = 3.0

    name = "broyden"
    predicts_markers = False

    def init(self) -> BroydenMemory:
        return BroydenMemory(np.zeros((3, 3)), None, None)

    def update(self, memory: BroydenMemory, tool: Tool, sample: Sample) -> BroydenMemory:
        if memory.p1 is None or memory.points is None:
            return BroydenMemory(memory.J_hat, sample.p1, sample.points)
        J_hat, is_updated = update_from_frame(
            memory.J_hat,
            memory.p1,
            memory.points,
            sample.p1,
            sample.points,
            sample.o_c,
            self.min_step,
        )
        return BroydenMemory(J_hat, sample.p1, sample.points) if is_updated else memory

    def jacobian(self, memory: BroydenMemory, tool: Tool, sample: Sample) -> Floats:
        return memory.J_hat
