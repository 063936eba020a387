"""Estimator of one constant Jacobian of the four marker coordinates, from the exploration."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rcmservo.estimation.base import Estimator, Sample
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.small_linalg import multiply_matrices


class FirstFrames(NamedTuple):
    """Observations of the first frames.

    Parameters
    ----------
    p1 : Floats
        Positions p₁ (n, 3) in mm, from the joints.
    m : Floats
        Raw pixels (n, 4) of both markers.
    """

    p1: Floats
    m: Floats


@dataclass(frozen=True)
class ConstantJacobian(Estimator):
    """Least-squares fit of m ≈ m₀ + L (p₁ − p₀), with L (4, 3) in px/mm, over the first frames.

    Parameters
    ----------
    frames : int
        Number of frames, about the length of an exploration.
    """

    frames: int = 60

    name = "constant"

    def init(self) -> FirstFrames:
        return FirstFrames(np.empty((0, 3)), np.empty((0, 4)))

    def update(self, memory: FirstFrames, tool: Tool, sample: Sample) -> FirstFrames:
        if len(memory.p1) >= self.frames:
            return memory
        return FirstFrames(
            np.vstack([memory.p1, sample.p1]), np.vstack([memory.m, sample.points.ravel()])
        )

    def markers_jacobian(self, memory: FirstFrames, tool: Tool, sample: Sample) -> Floats:
        p, m = (values - values.mean(axis=0) for values in memory)
        return np.asarray(np.linalg.lstsq(p, m, rcond=None)[0].T, dtype=np.float64)

    def jacobian(self, memory: FirstFrames, tool: Tool, sample: Sample) -> Floats:
        motion = self.markers_jacobian(memory, tool, sample)
        return multiply_matrices(
            compute_features_jacobian(shift_to_rcm(sample.points, sample.o_c)), motion
        )
