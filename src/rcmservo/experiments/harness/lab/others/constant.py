"""One constant Jacobian of the four marker coordinates, learnt while exploring and kept."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.loops import products
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.features import about, features_jacobian
from rcmservo.method.tool import Tool


class Seen(NamedTuple):
    """What the frames so far have shown."""

    p1: Floats
    """(n, 3) mm, p₁ by the joints."""
    m: Floats
    """(n, 4) px, the raw pixels seen there."""


@dataclass(frozen=True)
class ConstantJacobian(Estimator):
    """The one L (4, 3) px/mm that explains the first frames best: m ≈ m₀ + L (p₁ − p₀), by least
    squares."""

    frames: int = 60
    """That it learns from; an exploration takes about as many."""

    name = "constant"

    def init(self) -> Seen:
        return Seen(np.empty((0, 3)), np.empty((0, 4)))

    def update(self, memory: Seen, tool: Tool, sample: Sample) -> Seen:
        if len(memory.p1) >= self.frames:
            return memory
        return Seen(np.vstack([memory.p1, sample.p1]), np.vstack([memory.m, sample.points.ravel()]))

    def motion(self, memory: Seen, tool: Tool, sample: Sample) -> Floats:
        p, m = (one - one.mean(axis=0) for one in memory)
        return np.asarray(np.linalg.lstsq(p, m, rcond=None)[0].T, dtype=np.float64)

    def jacobian(self, memory: Seen, tool: Tool, sample: Sample) -> Floats:
        motion = self.motion(memory, tool, sample)
        return products(features_jacobian(about(sample.points, sample.o_c)), motion)
