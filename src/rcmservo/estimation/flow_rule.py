"""Flow-based estimation, eq. (26)-(30), which adapts Ĵ to the measured flow ẏ ≈ Ĵ ṗ₁.

Rule (28) is dĴ/dt = −γ (Ĵ ṗ₁ − ẏ) ṗ₁ᵀ. Each new frame integrates it exactly for the mean velocity
between the two exposures. The error along Δp₁ decays by exp(−γ |ṗ₁| |Δp₁|), so that no step is too
long. Between frames there is no measurement, and Ĵ stays.
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


@compiled
def integrate_flow_rule(
    J: Floats, delta_p: Floats, delta_y: Floats, dt: float, gamma: float
) -> Floats:
    """Return Ĵ (3, 3) after dt s of rule (28) at the constant velocity Δp/dt and flow Δy/dt."""
    squared = delta_p[0] ** 2 + delta_p[1] ** 2 + delta_p[2] ** 2
    if not (squared > 0.0 and dt > 0.0):
        return J.copy()
    return rank_one_update(J, delta_p, delta_y, -np.expm1(-gamma * squared / dt))


@compiled
def update_from_frame(
    J: Floats,
    delta_p: Floats,
    points_before: Floats,
    points: Floats,
    o_c: Floats,
    dt: float,
    gamma: float,
) -> Floats:
    """Return Ĵ after a new frame.

    The features of both frames are taken about the present o_c, so that a change of o_c is not
    flow.
    """
    delta_y = compute_feature_error(
        compute_features(shift_to_rcm(points, o_c)),
        compute_features(shift_to_rcm(points_before, o_c)),
    )
    return integrate_flow_rule(J, delta_p, delta_y, dt, gamma)


class FlowMemory(NamedTuple):
    """Ĵ and the previous frame.

    Parameters
    ----------
    J_hat : Floats
        Ĵ (3, 3) in rad/mm, px/mm, px/mm; zeros before the second frame.
    p1 : Floats or None
        p₁ (3,) mm in the previous frame; None before the first frame.
    points : Floats or None
        Markers (2, 2) in raw px of the previous frame; None before the first frame.
    """

    J_hat: Floats
    p1: Floats | None
    points: Floats | None


@dataclass(frozen=True)
class FlowEstimator(Estimator):
    """Estimator of Ĵ by the flow-based rule (28).

    Each new frame integrates the rule exactly for the mean velocity since the previous frame:

        dĴ/dt = −γ (Ĵ ṗ₁ − ẏ) ṗ₁ᵀ

    Parameters
    ----------
    gamma : float
        Gain γ (s/mm²), for any unit of y.

    Raises
    ------
    BadInput
        If `gamma` is not a positive number.

    Notes
    -----
    Its error decays by exp(−γ |ṗ₁| |Δp₁|) along the motion and not at all across it. With the
    paper's γ = 0.001 a slow motion changes Ĵ little. It has no model of the markers.

    References
    ----------
    Section III-C of the paper, eq. (26)-(30) and Proposition 2.
    """

    gamma: Annotated[float, positive("gain in s/mm²")] = 0.001

    name = "flow"
    predicts_markers = False
    advice = "a larger γ (gamma) lets the flow rule adapt faster to the same motion"

    def init(self) -> FlowMemory:
        return FlowMemory(np.zeros((3, 3)), None, None)

    def update(self, memory: FlowMemory, tool: Tool, sample: Sample) -> FlowMemory:
        J_hat = memory.J_hat
        if memory.p1 is not None and memory.points is not None:
            J_hat = update_from_frame(
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
