"""Flow-based estimation, eq. (26)-(30), which adapts Ĵ to the measured flow ẏ ≈ Ĵ ṗ₁.

Rule (28) is dĴ/dt = −γ (Ĵ ṗ₁ − ẏ) ṗ₁ᵀ. Each new frame integrates it exactly for the mean velocity
between the two exposures. The error along Δp₁ decays by exp(−γ |ṗ₁| |Δp₁|), so that no step is too
long. Between frames there is no measurement, and Ĵ stays.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import positive
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.displacement import (
    DisplacementMemory,
    apply_rank_one_update,
    measure_displacement,
)
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled


@dataclass(frozen=True)
class FlowEstimator(Estimator):
    """Estimator of Ĵ by the flow-based rule (28).

    With the velocity ṗ₁ (3,) mm/s of marker 1 and the rate ẏ (3,) of the features in rad/s, px/s,
    px/s, the rule changes Ĵ (3, 3) in rad/mm, px/mm, px/mm by

        dĴ/dt = −γ (Ĵ ṗ₁ − ẏ) ṗ₁ᵀ

    Each new frame integrates it exactly for the mean velocity since the previous frame.

    Parameters
    ----------
    gamma : float
        Gain γ (s/mm²), positive, for any unit of y.

    Raises
    ------
    BadInput
        If `gamma` is not a positive number.

    Notes
    -----
    The error of Ĵ decays by exp(−γ |ṗ₁| |Δp₁|) along the motion and not at all across it. With the
    paper's γ = 0.001 s/mm² a slow motion changes Ĵ little. The estimator does not predict markers.

    References
    ----------
    Section III-C of the paper, eq. (26)-(30) and Proposition 2.
    """

    gamma: Annotated[float, positive("gain in s/mm²")] = 0.001

    name = "flow"
    advice = "a larger γ (gamma) lets the flow rule adapt faster to the same motion"

    def init(self) -> DisplacementMemory:
        """Return the memory before the first frame: Ĵ = 0."""
        return DisplacementMemory(np.zeros((3, 3)), np.empty(0))

    def update(self, memory: DisplacementMemory, tool: Tool, sample: Sample) -> DisplacementMemory:
        """Return the memory after rule (28) is integrated over the time since the last frame."""
        J_hat = memory.J_hat
        if memory.p1 is not None and memory.points is not None:
            delta_p, delta_y = measure_displacement(
                memory.p1, memory.points, sample.p1, sample.points, sample.o_c
            )
            J_hat = integrate_flow_rule(J_hat, delta_p, delta_y, sample.dt, self.gamma)
        return DisplacementMemory(J_hat, memory.P, sample.p1, sample.points)

    def jacobian(self, memory: DisplacementMemory, tool: Tool, sample: Sample) -> Floats:
        """Return the stored Ĵ (3, 3) in rad/mm, px/mm, px/mm."""
        return memory.J_hat


@compiled
def integrate_flow_rule(
    J: Floats, delta_p: Floats, delta_y: Floats, dt: float, gamma: float
) -> Floats:
    """Return Ĵ (3, 3) after dt s of rule (28) at the constant velocity Δp/dt and flow Δy/dt."""
    squared = delta_p[0] ** 2 + delta_p[1] ** 2 + delta_p[2] ** 2
    if not (squared > 0.0 and dt > 0.0):
        return J.copy()
    return apply_rank_one_update(J, delta_p, delta_y, -np.expm1(-gamma * squared / dt))
