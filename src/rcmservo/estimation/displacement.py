"""What the estimators that learn from displacements share: where one begins and ends, and what it
leaves uncertain.

A displacement (Δp₁, Δy) begins where the last one ended, and ends in the first frame in which
marker 1 is `min_step` away from there. So a tool at rest makes none, whatever the noise of its
frames, and nothing is learnt from its shaking at the target. Both ends are taken about one imaged
RCM, so that moves of o_c are no flow.

The derivatives of one feature by p₁ are a row of Ĵ; P (3, 3) is their covariance.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from rcmservo.constraints import positive
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.geometry.features import about, difference, features
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import length, minus, product

LOOK_FURTHER = (
    "a longer first motion (exploration.reach, exploration.leg) tells more of each direction above "
    "the noise"
)
"""Advice where a displacement counts by its length."""


@compiled
def displaced(
    p1_before: Floats, before: Floats, p1: Floats, points: Floats, o_c: Floats, min_step: float
) -> tuple[Floats, Floats, bool]:
    """Δp₁ (3,) mm and Δy (3,) from the raw `before` (2, 2) px to `points`, and whether p₁ has gone
    far enough to learn from them.
    """
    delta_p = minus(p1, p1_before)
    delta_y = difference(features(about(points, o_c)), features(about(before, o_c)))
    return delta_p, delta_y, length(delta_p) >= min_step


@compiled
def gain(P: Floats, delta_p: Floats, R: float) -> Floats:
    """K = P Δp / (Δpᵀ P Δp + R) (3,): the share of what is new in one feature that each of its
    derivatives takes, where the flow's variance is R.
    """
    K, variance = product(P, delta_p), R
    for i in range(3):
        variance += delta_p[i] * K[i]
    for i in range(3):
        K[i] /= variance
    return K


@compiled
def left_uncertain(P: Floats, delta_p: Floats, R: float, K: Floats) -> Floats:
    """(I − K Δpᵀ) P (I − K Δpᵀ)ᵀ + R K Kᵀ (3, 3): P once the gain K has been used, in Joseph's
    form, which stays symmetric and positive definite whatever the gain.
    """
    kept, half, out = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            kept[i, j] = (1.0 if i == j else 0.0) - K[i] * delta_p[j]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                half[i, j] += kept[i, k] * P[k, j]
    for i in range(3):
        for j in range(i + 1):
            total = R * K[i] * K[j]
            for k in range(3):
                total += half[i, k] * kept[j, k]
            out[i, j] = out[j, i] = total
    return out


@compiled
def corrected(J: Floats, delta_p: Floats, delta_y: Floats, K: Floats) -> Floats:
    """Ĵ + (Δy − Ĵ Δp) Kᵀ (3, 3)."""
    foretold, out = product(J, delta_p), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = J[i, j] + (delta_y[i] - foretold[i]) * K[j]
    return out


class DisplacementMemory(NamedTuple):
    """Ĵ, and where the last displacement ended.

    Parameters
    ----------
    J_hat : Floats
        Ĵ (3, 3) rad/mm, px/mm, px/mm; zeros at first.
    P : Floats
        Covariance of the rows of Ĵ: (3, 3) of each, (3, 3, 3) where they differ, empty where an
        estimator has none.
    p1 : Floats or None
        p₁ (3,) mm there; None before the first frame.
    points : Floats or None
        The markers (2, 2) raw px there; None before the first frame.
    """

    J_hat: Floats
    P: Floats
    p1: Floats | None
    points: Floats | None


@dataclass(frozen=True)
class ByDisplacements(Estimator):
    """Learns Ĵ from one displacement after the other.

    Parameters
    ----------
    min_step : float
        Way of marker 1 from which on it is a displacement, mm: a pixel of noise is 1/min_step px/mm
        of it.
    """

    min_step: Annotated[float, positive("length in mm")] = 2.0

    @abstractmethod
    def uncertain(self) -> Floats:
        """P before the first displacement."""

    @abstractmethod
    def learn(
        self, J_hat: Floats, P: Floats, delta_p: Floats, delta_y: Floats
    ) -> tuple[Floats, Floats]:
        """Ĵ and P after a displacement."""

    def init(self) -> DisplacementMemory:
        return DisplacementMemory(np.zeros((3, 3)), self.uncertain(), None, None)

    def update(self, memory: DisplacementMemory, tool: Tool, sample: Sample) -> DisplacementMemory:
        if memory.p1 is None or memory.points is None:
            return memory._replace(p1=sample.p1, points=sample.points)
        delta_p, delta_y, far = displaced(
            memory.p1, memory.points, sample.p1, sample.points, sample.o_c, self.min_step
        )
        if not far:
            return memory
        J_hat, P = self.learn(memory.J_hat, memory.P, delta_p, delta_y)
        return DisplacementMemory(J_hat, P, sample.p1, sample.points)

    def jacobian(self, memory: DisplacementMemory, tool: Tool, sample: Sample) -> Floats:
        return memory.J_hat


@compiled
def toward(J: Floats, delta_p: Floats, delta_y: Floats, share: float) -> Floats:
    """J + share (Δy − J Δp) Δpᵀ/|Δp|² (3, 3); Δp (3,) mm must not be zero."""
    squared = delta_p[0] ** 2 + delta_p[1] ** 2 + delta_p[2] ** 2
    foretold, out = product(J, delta_p), np.empty(J.shape)
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            out[i, j] = J[i, j] + share / squared * (delta_y[i] - foretold[i]) * delta_p[j]
    return out
