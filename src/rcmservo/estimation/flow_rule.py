"""Flow-based estimation, eq. (26)-(30): turn Ĵ towards the measured flow, ẏ ≈ Ĵ ṗ₁.

Rule (28) is dĴ/dt = −γ (Ĵ ṗ₁ − ẏ) ṗ₁ᵀ. Once per new frame it is integrated exactly, for the mean
velocity between the two exposures: along Δp₁ the error decays by exp(−γ |ṗ₁| |Δp₁|), so that no
step is too long. Between frames nothing was seen and nothing is learnt.
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


@compiled
def learn(J: Floats, delta_p: Floats, delta_y: Floats, dt: float, gamma: float) -> Floats:
    """Ĵ (3, 3) after dt s of rule (28) at the constant velocity Δp/dt and flow Δy/dt."""
    squared = delta_p[0] ** 2 + delta_p[1] ** 2 + delta_p[2] ** 2
    if not (squared > 0.0 and dt > 0.0):
        return J.copy()
    return toward(J, delta_p, delta_y, -np.expm1(-gamma * squared / dt))


@compiled
def update(
    J: Floats,
    delta_p: Floats,
    before: Floats,
    points: Floats,
    o_c: Floats,
    dt: float,
    gamma: float,
) -> Floats:
    """Ĵ after a new frame; both frames' features are taken about the present o_c, so that its moves
    are no flow.
    """
    delta_y = difference(features(about(points, o_c)), features(about(before, o_c)))
    return learn(J, delta_p, delta_y, dt, gamma)


class FlowMemory(NamedTuple):
    """Ĵ, and the frame before.

    Parameters
    ----------
    J_hat : Floats
        Ĵ (3, 3) rad/mm, px/mm, px/mm; zeros at first.
    p1 : Floats or None
        p₁ (3,) mm in the frame before; None at first.
    points : Floats or None
        The markers (2, 2) raw px in the frame before; None at first.
    """

    J_hat: Floats
    p1: Floats | None
    points: Floats | None


@dataclass(frozen=True)
class FlowEstimator(Estimator):
    """Ĵ from flow, rule (28).

    Parameters
    ----------
    gamma : float
        γ, s/mm² whatever the unit of y.
    """

    gamma: Annotated[float, positive("gain in s/mm²")] = 0.001

    name = "flow"
    models = False
    advice = "a larger γ (gamma) lets the flow rule learn more from the same motion"

    def init(self) -> FlowMemory:
        return FlowMemory(np.zeros((3, 3)), None, None)

    def update(self, memory: FlowMemory, tool: Tool, sample: Sample) -> FlowMemory:
        J_hat = memory.J_hat
        if memory.p1 is not None and memory.points is not None:
            J_hat = update(
                J_hat,
                sample.p1 - memory.p1,
                memory.points,
                sample.points,
                sample.o_c,
                sample.dt,
                self.gamma,
            )
        return FlowMemory(J_hat, sample.p1, sample.points)

    def jacobian(self, memory: FlowMemory, tool: Tool, sample: Sample) -> Floats:
        return memory.J_hat
