"""From the feature error to a velocity: the saturated potential (32) and the law (31), v = −k Ĵ⁻¹
∂V/∂y.

The inverse is taken on the scaled Jacobian diag(1/SCALE) Ĵ, where a condition number means the same
in every scene. It is damped when the condition nears its limit, and where the estimate is worse
than that there is no velocity at all.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.loops import all_finite, length, over
from rcmservo.method.features import SCALE
from rcmservo.method.singular import right_angled


@compiled
def potential_gradient(delta: Floats, bounds: Floats, printed: bool) -> Floats:
    """∂V/∂y (3,): Δy inside ±b and, beyond, ±b (continuous, Fig. 5) or ±b/2 (as (32) is
    printed)."""
    beyond = 0.5 if printed else 1.0
    gradient = np.empty(3)
    for i in range(3):
        inside = abs(delta[i]) < bounds[i]
        gradient[i] = delta[i] if inside else np.sign(delta[i]) * beyond * bounds[i]
    return gradient


@compiled
def potential(delta: Floats, bounds: Floats, printed: bool) -> float:
    """V = Σ Vᵢ of (32): ½Δy² inside ±b and, beyond, b|Δy| − ½b² (continuous) or ½b|Δy|
    (printed)."""
    total = 0.0
    for i in range(3):
        size = abs(delta[i])
        if size < bounds[i]:
            total += 0.5 * size**2
        elif printed:
            total += 0.5 * bounds[i] * size
        else:
            total += bounds[i] * size - 0.5 * bounds[i] ** 2
    return total


@compiled
def scaled(J: Floats) -> Floats:
    """diag(1/SCALE) J: every norm and condition is judged on this."""
    out = np.empty(J.shape)
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            out[i, j] = J[i, j] / SCALE[i]
    return out


@compiled
def law(
    J_hat: Floats, gradient: Floats, gain: float, max_condition: float, max_speed: float
) -> tuple[Floats, float]:
    """v (3,) mm/s of eq. (31) and the condition of the scaled Ĵ; v is zero where the condition is
    above its limit.

    v is built along the right-angled columns of B = diag(1/SCALE) Ĵ V, whose lengths σ are the
    singular values. From half the limit of the condition on, those below 2σ₁/limit are damped, so
    that |v| stops growing. The whole velocity is scaled down where it exceeds max_speed, so that
    its direction stays.
    """
    v = np.zeros(3)
    if not all_finite(J_hat):
        return v, np.inf
    B, V = right_angled(scaled(J_hat))
    low, high = np.inf, 0.0
    for i in range(3):
        sigma = length(B[:, i])
        low, high = min(low, sigma), max(high, sigma)
    condition = high / low if low > 0.0 and high < np.inf else np.inf
    if not condition < max_condition:
        return v, condition
    floor = 2.0 * high / max_condition
    for i in range(3):
        sigma, along = length(B[:, i]), 0.0
        for k in range(len(B)):
            along += B[k, i] * gradient[k] / SCALE[k]
        shortfall = max(1.0 - sigma / floor, 0.0)
        share = gain * along / (sigma**2 + (shortfall * floor) ** 2)
        for k in range(3):
            v[k] -= V[k, i] * share
    slower = max(1.0, length(v) / max_speed)
    for k in range(3):
        v[k] /= slower
    return v, condition


@compiled
def control(
    J_hat: Floats,
    delta: Floats,
    bounds: Floats,
    printed: bool,
    gain: float,
    max_condition: float,
    max_speed: float,
) -> tuple[Floats, float, float]:
    """For the error Δy (3,): v (3,) mm/s by (32) and (31), the scaled condition of Ĵ, and √(2V) of
    the scaled error.

    √(2V) is |Δy| where nothing is saturated. (33) makes V fall, while one component alone may rise
    on the way.
    """
    gradient = potential_gradient(delta, bounds, printed)
    v, condition = law(J_hat, gradient, gain, max_condition, max_speed)
    return v, condition, np.sqrt(2.0 * potential(over(delta, SCALE), over(bounds, SCALE), printed))


@dataclass(frozen=True)
class SaturatedController:
    """The law (31) with the saturated potential (32)."""

    gain: float = 2.0
    """k, 1/s."""
    bounds: tuple[float, float, float] = (float(np.radians(50.0)), 50.0, 50.0)
    """b, the feature errors (rad, px, px) from which on the action is saturated."""
    potential: Literal["continuous", "printed"] = "continuous"
    """V: continuous as Fig. 5 asks, or printed as (32) reads, where the action drops to half at
    b."""
    max_speed: float = 40.0
    """Cap on |v|, mm/s."""
    max_condition: float = 150.0
    """Condition number of the scaled Jacobian above which the tool stands still."""

    @cached_property
    def b(self) -> Floats:
        """The bounds (3,)."""
        return np.array(self.bounds)

    def __post_init__(self) -> None:
        require(0.0 < self.gain < np.inf, "controller.gain", self.gain, "a positive gain in 1/s")
        good = len(self.bounds) == 3 and all(0.0 < b < np.inf for b in self.bounds)
        require(good, "controller.bounds", self.bounds, "three positive numbers (rad, px, px)")
        known = self.potential in ("continuous", "printed")
        require(known, "controller.potential", self.potential, "'continuous' or 'printed'")
        require(
            0.0 < self.max_speed < np.inf,
            "controller.max_speed",
            self.max_speed,
            "a positive speed in mm/s",
        )
        require(
            1.0 < self.max_condition < np.inf,
            "controller.max_condition",
            self.max_condition,
            "a number above 1",
        )
