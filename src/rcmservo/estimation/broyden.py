"""Broyden's rank-1 update: the least change of Ĵ that explains the latest displacement, Ĵ Δp₁ = Δy.

    Ĵ += (Δy − Ĵ Δp₁) Δp₁ᵀ / (Δp₁ᵀ Δp₁)

This is what III-C compares rule (28) to, and where (28) goes for large γ: along Δp₁ all of the
error is learnt at once, whatever speed and time. So is the noise, by its size over |Δp₁|. An update
therefore waits until marker 1 has gone `min_step` from where the last one was made; below that
nothing is learnt.

C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19
(1965) 577-593.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from rcmservo.constraints import positive
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.displacement import toward
from rcmservo.geometry.features import about, difference, features
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import length, minus


@compiled
def learn(J: Floats, delta_p: Floats, delta_y: Floats) -> Floats:
    """Ĵ (3, 3) nearest to J of all with Ĵ Δp = Δy; Δp (3,) mm must not be zero."""
    return toward(J, delta_p, delta_y, 1.0)


@compiled
def update(
    J: Floats,
    p1_before: Floats,
    before: Floats,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    min_step: float,
) -> tuple[Floats, bool]:
    """Ĵ after a new frame, and whether p₁ had gone far enough to learn from; both ends' features
    are about one o_c.
    """
    delta_p = minus(p1, p1_before)
    if not length(delta_p) >= min_step:
        return J.copy(), False
    delta_y = difference(features(about(points, o_c)), features(about(before, o_c)))
    return learn(J, delta_p, delta_y), True


class BroydenMemory(NamedTuple):
    """Ĵ, and where its last update was made.

    Parameters
    ----------
    J_hat : Floats
        Ĵ (3, 3) rad/mm, px/mm, px/mm; zeros at first.
    p1 : Floats or None
        p₁ (3,) mm at the last update, or in the first frame; None before it.
    points : Floats or None
        The markers (2, 2) raw px then; None before the first frame.
    """

    J_hat: Floats
    p1: Floats | None
    points: Floats | None


@dataclass(frozen=True)
class BroydenEstimator(Estimator):
    """Ĵ by Broyden's rank-1 update.

    Parameters
    ----------
    min_step : float
        Least displacement of marker 1 between two updates, mm: a pixel of noise enters Ĵ as
        1/min_step px/mm.
    """

    min_step: Annotated[float, positive("length in mm")] = 3.0

    name = "broyden"
    models = False

    def init(self) -> BroydenMemory:
        return BroydenMemory(np.zeros((3, 3)), None, None)

    def update(self, memory: BroydenMemory, tool: Tool, sample: Sample) -> BroydenMemory:
        if memory.p1 is None or memory.points is None:
            return BroydenMemory(memory.J_hat, sample.p1, sample.points)
        J_hat, learnt = update(
            memory.J_hat,
            memory.p1,
            memory.points,
            sample.p1,
            sample.points,
            sample.o_c,
            self.min_step,
        )
        return BroydenMemory(J_hat, sample.p1, sample.points) if learnt else memory

    def jacobian(self, memory: BroydenMemory, tool: Tool, sample: Sample) -> Floats:
        return memory.J_hat
