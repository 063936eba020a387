"""Rule (21) on random observations as in the paper, instead of observations chosen by leverage."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rcmservo.errors import require
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.projection_rule import (
    GAMMA_0,
    MAX_OBSERVATIONS,
    build_normal_equations,
    collect_fitted_points,
    compute_jacobian_at_points,
    limit_step_by_depth,
    predict_markers,
)
from rcmservo.geometry.projection import PARAMETER_COUNT
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.gradient_flow import integrate_gradient_flow


class RandomMemory(NamedTuple):
    """State of the estimator.

    Parameters
    ----------
    observations : Floats
        Observations (P, 7): p₁ in mm, raw m₁ and m₂ in px.
    sample_count : int
        Number of samples so far, from which they were drawn.
    a_hat : Floats
        Estimated parameters (9,).
    """

    observations: Floats
    sample_count: int
    a_hat: Floats


@dataclass(frozen=True)
class RandomObservations(Estimator):
    """Rule (21) with the printed Γ, on P random observations as in the paper.

    Each sample so far is equally likely to be an observation (reservoir sampling).

    Parameters
    ----------
    observations : int
        Number P of observations.
    estimator_time : float
        Integration time (s) of the rule per frame; 0 for the real time between frames.
    """

    observations: int = 10
    estimator_time: float = 1e4

    name = "random"
    predicts_markers = True

    def __post_init__(self) -> None:
        is_valid = 1 <= self.observations <= MAX_OBSERVATIONS
        require(is_valid, "random.observations", self.observations, f"from 1 to {MAX_OBSERVATIONS}")
        is_valid = 0.0 <= self.estimator_time < np.inf
        require(is_valid, "random.estimator_time", self.estimator_time, "a time in s, at least 0")

    def init(self) -> RandomMemory:
        return RandomMemory(np.zeros((self.observations, 7)), 0, np.zeros(PARAMETER_COUNT))

    def update(self, memory: RandomMemory, tool: Tool, sample: Sample) -> RandomMemory:
        rows = self._add_sample(memory, sample)
        count = min(memory.sample_count + 1, len(rows))
        A, b = build_normal_equations(
            collect_fitted_points(rows, count, sample.o_c, False, tool.struct)
        )
        root = np.diag(np.sqrt(GAMMA_0))
        a_next = integrate_gradient_flow(A, b, memory.a_hat, root, self.estimator_time or sample.dt)
        a_hat = limit_step_by_depth(memory.a_hat, a_next, rows, count, tool.struct)
        return RandomMemory(rows, memory.sample_count + 1, a_hat)

    def _add_sample(self, memory: RandomMemory, sample: Sample) -> Floats:
        """Return the observations after one more sample, which may replace one of them."""
        rows, count = memory.observations.copy(), memory.sample_count
        drawn = int(np.random.default_rng(count).integers(count + 1))
        index = count if count < len(rows) else drawn
        if index < len(rows):
            rows[index] = np.concatenate([sample.p1, sample.points.ravel()])
        return rows

    def jacobian(self, memory: RandomMemory, tool: Tool, sample: Sample) -> Floats:
        return compute_jacobian_at_points(
            memory.a_hat, sample.p1, sample.points, sample.o_c, tool.struct
        )

    def predict(self, memory: RandomMemory, tool: Tool, p1: Floats) -> Floats:
        return predict_markers(memory.a_hat, p1, tool.struct)
