"""Recursive direct linear transformation: Ĵ through the whole projection, fitted to all frames and
both markers.

Its state is the fit of the camera's projection (projection_fit.py): eleven numbers, their
covariance, and the offset that the fit leaves over. The imaged RCM is one of its results.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rcmservo.estimation.base import Estimated, Estimator, KernelSample, Sample
from rcmservo.estimation.projection_fit import RCM, Prospect, blank, see
from rcmservo.estimation.projection_prediction import (
    add_offset,
    both_motions,
    expect,
    features_motion,
    image,
    imaged,
    located,
    motions,
)
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Rows


@compiled
def update_kernel(
    kernel: "DltKernel",
    memory: tuple[()],
    sample: KernelSample,
    fit: Prospect,
    result: Estimated,
) -> tuple[()]:
    """Take the estimate from the servo's own fit of the projection, which is all that it is."""
    if sample.fit_changed:
        image(fit, RCM, result.o_c, result.o_c_covariance)
    expect(fit, sample.p1, sample.shaft, result.points)
    add_offset(fit, result.points)
    motions(fit, sample.p1, sample.shaft, result.motion)
    result.placed = True
    return memory


@compiled
def empty_kernel(kernel: "DltKernel", memory: tuple[()]) -> tuple[()]:
    """Return the memory before the first frame: there is none."""
    return memory


class DltKernel(NamedTuple):
    """Compiled form of the direct linear transformation."""

    places_rcm = True
    update = update_kernel
    empty = empty_kernel


@dataclass(frozen=True)
class DltEstimator(Estimator):
    """Ĵ through the whole projection, fitted to all frames."""

    name = "dlt"
    models = True
    places_rcm = True
    spares_marker = True
    kernel = DltKernel()

    def init(self) -> Rows[Prospect]:
        return blank().rows

    def update(self, memory: Rows[Prospect], tool: Tool, sample: Sample) -> Rows[Prospect]:
        memory = memory.copy()
        see(memory[0], sample.p1, sample.points, tool.shaft)
        return memory

    def jacobian(self, memory: Rows[Prospect], tool: Tool, sample: Sample) -> Floats:
        p1, points, o_c, *_ = sample
        return features_motion(memory[0], p1, points, o_c, tool.shaft)

    def located(self, memory: Rows[Prospect], tool: Tool, sample: Sample) -> Floats:
        return located(memory[0], sample.p1, tool.shaft)

    def motion(self, memory: Rows[Prospect], tool: Tool, sample: Sample) -> Floats:
        return both_motions(memory[0], sample.p1, tool.shaft)

    def imaged_rcm(self, memory: Rows[Prospect]) -> tuple[Floats, Floats]:
        return imaged(memory[0], RCM)

    def predict(self, memory: Rows[Prospect], tool: Tool, p1: Floats) -> Floats:
        o_c, both = imaged(memory[0], RCM)[0], (p1.copy(), tool.second_marker(p1))
        return np.concatenate([imaged(memory[0], p)[0] - o_c for p in both])

    def remembered(self, memory: Any) -> Floats:
        known = Prospect(memory)
        numbers = known.A.ravel(), known.g, known.origin, known.offset.ravel(), [known.noise]
        return np.concatenate(numbers)
