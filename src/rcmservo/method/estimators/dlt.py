"""Recursive direct linear transformation: the whole projection, from all frames and both markers.

    m = (G x + c) / (1 + gᵀx),    x = (p − p₀) / 100 mm,    m in px from m₀

p₀ is the middle of the tool in the first frame and m₀ that of its markers there, so that the RCM
may lie before, in or behind the image plane, where (10) needs it before the camera. The eleven
numbers θ are fitted to the rows of (18), here [x̄ᵀ −u xᵀ] θ = u with x̄ = [x 1], weighted by 1/ẑ² so
that their errors are pixels. Four sums Σ w k x̄x̄ᵀ, with k = 1, u, v and u² + v², hold all of it. It
is rule (21) with Γ = (Σ w WᵀW + Γ₀⁻¹)⁻¹ run to its end, without a choice of observations. The sums
fade with the way travelled.

What the fit leaves over, averaged over the last frames near by, is the offset: fit and offset are
the markers without their noise. The transformation is that of Abdel-Aziz and Karara (1971).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.loops import length, minus, products, put
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.features import about, features_jacobian
from rcmservo.method.tool import Shaft, Tool, second_marker, second_marker_jacobian

PARAMETERS = 11
UNIT = 100.0
"""mm of one unit of x."""

LEAST_DEPTH = 0.2
"""Relative depth ẑ that a weight is made of at least."""

PRIOR = np.array([1e-6] * 8 + [1.0] * 3)
"""Diagonal of Γ₀⁻¹: G and c are within about 1000 px, g within about one per unit of x."""


class DltRule(NamedTuple):
    """What compiled functions know of the settings."""

    fade: float
    """Way in mm over which the sums fade to 1/e."""
    step: float
    """Way in mm of marker 1 from which on a frame counts in the sums."""
    near: float
    """Way in mm over which the offset fades to 1/e."""
    frames: float
    """Frames that the offset is the mean of at most."""


class DltMemory(NamedTuple):
    """The sums, the fit, and what it leaves over."""

    sums: Floats
    """(4, 4, 4): Σ w k x̄x̄ᵀ for k = 1, u, v, u² + v²."""
    origin: Floats
    """(5,) p₀ mm and m₀ px; NaN before the first frame."""
    theta: Floats
    """θ (11,) = the rows of [G c], then g; zeros at first."""
    summed: Floats
    """p₁ (3,) mm of the newest frame in the sums."""
    offset: Floats
    """(4,) px that both markers are off the fit."""
    weight: float
    """Frames that the offset is the mean of."""
    last: Floats
    """p₁ (3,) mm of the newest frame."""


@compiled
def fitted(theta: Floats, origin: Floats, p: Floats) -> tuple[Floats, Floats, float]:
    """Where the fit has a point p (3,) mm: its x (3,), its picture (2,) px from m₀, and ẑ."""
    x, m, z = np.empty(3), np.array([theta[3], theta[7]]), 1.0
    for i in range(3):
        x[i] = (p[i] - origin[i]) / UNIT
        m[0] += theta[i] * x[i]
        m[1] += theta[4 + i] * x[i]
        z += theta[8 + i] * x[i]
    m[0] /= z
    m[1] /= z
    return x, m, z


@compiled
def add(sums: Floats, x: Floats, m: Floats, weight: float) -> None:
    """Take one point into the sums: x (3,) and its picture m (2,) px from m₀."""
    u, v = m[0], m[1]
    kinds = (1.0, u, v, u * u + v * v)
    for i in range(4):
        for j in range(4):
            square = weight * (x[i] if i < 3 else 1.0) * (x[j] if j < 3 else 1.0)
            for k in range(4):
                sums[k, i, j] += kinds[k] * square


@compiled
def normal_equations(sums: Floats) -> tuple[Floats, Floats]:
    """Σ w WᵀW + Γ₀⁻¹ (11, 11) and the right-hand side (11,)."""
    N, b = np.diag(PRIOR), np.empty(PARAMETERS)
    for i in range(4):
        b[i], b[4 + i] = sums[1, i, 3], sums[2, i, 3]
        for j in range(4):
            N[i, j] += sums[0, i, j]
            N[4 + i, 4 + j] += sums[0, i, j]
        for j in range(3):
            N[i, 8 + j] = N[8 + j, i] = -sums[1, i, j]
            N[4 + i, 8 + j] = N[8 + j, 4 + i] = -sums[2, i, j]
    for i in range(3):
        b[8 + i] = -sums[3, i, 3]
        for j in range(3):
            N[8 + i, 8 + j] += sums[3, i, j]
    return N, b


@compiled
def update(memory: DltMemory, p1: Floats, points: Floats, rule: DltRule, shaft: Shaft) -> DltMemory:
    """Take in one frame: raw `points` (2, 2) px of the markers, with marker 1 at p1 (3,) mm."""
    p2, origin, sums, theta = (
        second_marker(shaft, p1),
        memory.origin,
        memory.sums,
        memory.theta.copy(),
    )
    first = not np.isfinite(origin[0])
    if first:
        origin = begun(p1, p2, points)
    way, summed = length(minus(p1, memory.summed)), memory.summed
    if first or way >= rule.step:
        sums = (0.0 if first else np.exp(-way / rule.fade)) * sums
        for k in range(2):
            x, _, z = fitted(theta, origin, p1.copy() if k == 0 else p2)
            add(sums, x, minus(points[k], origin[3:]), 1.0 / max(z, LEAST_DEPTH) ** 2)
        N, b = normal_equations(sums)
        solution: Any = np.linalg.solve(N, b)
        put(theta, solution)
        summed = p1.copy()
    stays = 0.0 if first else np.exp(-length(minus(p1, memory.last)) / rule.near)
    weight = min(stays * memory.weight + 1.0, rule.frames)
    offset = memory.offset.copy()
    for k in range(2):
        _, m, _ = fitted(theta, origin, p1.copy() if k == 0 else p2)
        for i in range(2):
            left = points[k, i] - origin[3 + i] - m[i]
            offset[2 * k + i] += (left - offset[2 * k + i]) / weight
    return DltMemory(sums, origin, theta, summed, offset, weight, p1.copy())


@compiled
def begun(p1: Floats, p2: Floats, points: Floats) -> Floats:
    """p₀ and m₀ (5,) of the first frame."""
    origin = np.empty(5)
    for i in range(3):
        origin[i] = 0.5 * (p1[i] + p2[i])
    for i in range(2):
        origin[3 + i] = 0.5 * (points[0, i] + points[1, i])
    return origin


@compiled
def located(memory: DltMemory, p1: Floats, shaft: Shaft) -> Floats:
    """The markers (2, 2) raw px at p1 (3,) mm: fit and offset."""
    p2, points = second_marker(shaft, p1), np.empty((2, 2))
    for k in range(2):
        _, m, _ = fitted(memory.theta, memory.origin, p1.copy() if k == 0 else p2)
        for i in range(2):
            points[k, i] = memory.origin[3 + i] + m[i] + memory.offset[2 * k + i]
    return points


@compiled
def point_jacobian(theta: Floats, origin: Floats, p: Floats) -> Floats:
    """∂m/∂p (2, 3) px/mm of the fit at a point p (3,) mm."""
    _, m, z = fitted(theta, origin, p)
    jacobian = np.empty((2, 3))
    for i in range(3):
        jacobian[0, i] = (theta[i] - m[0] * theta[8 + i]) / (z * UNIT)
        jacobian[1, i] = (theta[4 + i] - m[1] * theta[8 + i]) / (z * UNIT)
    return jacobian


@compiled
def jacobian_at(memory: DltMemory, p1: Floats, points: Floats, o_c: Floats, shaft: Shaft) -> Floats:
    """Ĵ (3, 3) of eq. (15): ∂y/∂m at raw `points` (2, 2) px about o_c, ∂m/∂p₁ of the fit."""
    theta, origin, p2, markers = (
        memory.theta,
        memory.origin,
        second_marker(shaft, p1),
        np.empty((4, 3)),
    )
    put(markers[:2], point_jacobian(theta, origin, p1.copy()))
    second = products(point_jacobian(theta, origin, p2), second_marker_jacobian(shaft, p1))
    put(markers[2:], second)
    return products(features_jacobian(about(points, o_c)), markers)


@compiled
def imaged(memory: DltMemory, p: Floats) -> Floats:
    """Where the fit has the picture of a point p (3,) mm, (2,) raw px."""
    _, m, _ = fitted(memory.theta, memory.origin, p)
    return np.array([memory.origin[3] + m[0], memory.origin[4] + m[1]])


@dataclass(frozen=True)
class DltEstimator(Estimator):
    """Ĵ through the whole projection, fitted to all frames."""

    fade: float = 300.0
    """Way of marker 1 over which old frames fade to 1/e, mm."""
    step: float = 0.3
    """Way of marker 1 from one frame that the fit learns from to the next, mm."""
    near: float = 40.0
    """Way of marker 1 over which the mean of what the fit leaves over fades to 1/e, mm."""
    frames: int = 300
    """Frames that this is the mean of at most."""

    name = "dlt"
    models = True

    def __post_init__(self) -> None:
        for name in ("fade", "step", "near"):
            value = getattr(self, name)
            require(0.0 < value < np.inf, f"estimator.{name}", value, "a positive length in mm")
        good = 1 <= self.frames <= 100_000
        require(good, "estimator.frames", self.frames, "a whole number of frames from 1 to 100000")

    def init(self) -> DltMemory:
        return DltMemory(
            np.zeros((4, 4, 4)), np.full(5, np.nan), np.zeros(PARAMETERS),
            np.zeros(3), np.zeros(4), 0.0, np.zeros(3),
        )  # fmt: skip

    @cached_property
    def rule(self) -> DltRule:
        """What compiled functions know of it."""
        return DltRule(float(self.fade), float(self.step), float(self.near), float(self.frames))

    def update(self, memory: DltMemory, tool: Tool, sample: Sample) -> DltMemory:
        return update(memory, sample.p1, sample.points, self.rule, tool.shaft)

    def jacobian(self, memory: DltMemory, tool: Tool, sample: Sample) -> Floats:
        return jacobian_at(memory, sample.p1, sample.points, sample.o_c, tool.shaft)

    def located(self, memory: DltMemory, tool: Tool, sample: Sample) -> Floats:
        return located(memory, sample.p1, tool.shaft)

    def predict(self, memory: DltMemory, tool: Tool, p1: Floats) -> Floats:
        both = [imaged(memory, p1.copy()), imaged(memory, tool.second_marker(p1))]
        return np.concatenate(both - imaged(memory, np.zeros(3)))

    def remembered(self, memory: DltMemory) -> Floats:
        return np.concatenate([memory.theta, memory.origin, memory.offset])
