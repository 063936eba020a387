"""Rule (21) on random observations, as the paper has them; this software chooses them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rcmservo.errors import require
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.projection_rule import (
    GAMMA_0,
    MOST,
    jacobian_at,
    keep_in_front,
    normal_equations,
    predict,
    sights,
)
from rcmservo.geometry.projection import PARAMETERS
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.gradient_flow import decay


class RandomMemory(NamedTuple):
    """State of the estimator.

    Parameters
    ----------
    observations : Floats
        Rows (P, 7) [p₁ mm, raw m₁ m₂ px].
    seen : int
        Number of samples that they were drawn from.
    a_hat : Floats
        Parameters (9,).
    """

    observations: Floats
    seen: int
    a_hat: Floats


@dataclass(frozen=True)
class RandomObservations(Estimator):
    """Rule (21) with the printed Γ as the paper words it, on P random observations.

    Of all samples so far each is as likely to be among them.

    Parameters
    ----------
    observations : int
        P.
    estimator_time : float
        s of its own time that the rule is given at every frame; 0 for the real time between two.
    """

    observations: int = 10
    estimator_time: float = 1e4

    name = "random"
    models = True

    def __post_init__(self) -> None:
        good = 1 <= self.observations <= MOST
        require(good, "random.observations", self.observations, f"from 1 to {MOST}")
        good = 0.0 <= self.estimator_time < np.inf
        require(good, "random.estimator_time", self.estimator_time, "a time in s, at least 0")

    def init(self) -> RandomMemory:
        return RandomMemory(np.zeros((self.observations, 7)), 0, np.zeros(PARAMETERS))

    def update(self, memory: RandomMemory, tool: Tool, sample: Sample) -> RandomMemory:
        kept = self._drawn(memory, sample)
        count = min(memory.seen + 1, len(kept))
        A, b = normal_equations(sights(kept, count, sample.o_c, False, tool.shaft))
        root = np.diag(np.sqrt(GAMMA_0))
        a_next = decay(A, b, memory.a_hat, root, self.estimator_time or sample.dt)
        a_hat = keep_in_front(memory.a_hat, a_next, kept, count, tool.shaft)
        return RandomMemory(kept, memory.seen + 1, a_hat)

    def _drawn(self, memory: RandomMemory, sample: Sample) -> Floats:
        """Return the observations after one more sample, which may replace a drawn one."""
        kept, seen = memory.observations.copy(), memory.seen
        drawn = int(np.random.default_rng(seen).integers(seen + 1))
        row = seen if seen < len(kept) else drawn
        if row < len(kept):
            kept[row] = np.concatenate([sample.p1, sample.points.ravel()])
        return kept

    def jacobian(self, memory: RandomMemory, tool: Tool, sample: Sample) -> Floats:
        return jacobian_at(memory.a_hat, sample.p1, sample.points, sample.o_c, tool.shaft)

    def predict(self, memory: RandomMemory, tool: Tool, p1: Floats) -> Floats:
        return predict(memory.a_hat, p1, tool.shaft)
