"""Estimator by the recursive direct linear transformation of both markers over all frames.

Its state is the fit of the camera's projection (camera_fit.py): eleven numbers, their
covariance, and the offset of the markers from the fit. The imaged RCM is one of its results.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rcmservo.estimation.base import Estimator, EstimatorResult, KernelSample, Sample
from rcmservo.estimation.camera_fit import (
    RCM_POSITION_MM,
    ProjectionFit,
    initial_fit,
    update_fit,
)
from rcmservo.estimation.camera_fit_prediction import (
    add_offset,
    filter_markers,
    fitted_features_jacobian,
    markers_jacobian,
    predict_image,
    write_markers_jacobian,
    write_predicted_image,
    write_predicted_markers,
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
    fit: ProjectionFit,
    result: EstimatorResult,
) -> tuple[()]:
    """Write the estimate of the servo's projection fit, the estimator's whole state."""
    if sample.fit_changed:
        write_predicted_image(fit, RCM_POSITION_MM, result.o_c, result.o_c_covariance)
    write_predicted_markers(fit, sample.p1, sample.shaft, result.points)
    add_offset(fit, result.points)
    write_markers_jacobian(fit, sample.p1, sample.shaft, result.markers_jacobian)
    result.has_imaged_rcm = True
    return memory


@compiled
def empty_kernel(kernel: "DltKernel", memory: tuple[()]) -> tuple[()]:
    """Return the memory before the first frame, which is empty."""
    return memory


class DltKernel(NamedTuple):
    """Compiled form of the direct linear transformation."""

    estimates_rcm = True
    update = update_kernel
    reset = empty_kernel


@dataclass(frozen=True)
class DltEstimator(Estimator):
    """Estimator of Ĵ by a projection fitted to all frames.

    The projection has eleven numbers, A (2, 4) and g (3,), with x̄ = [x 1]:

        m = A x̄ / (1 + gᵀx),    x = (p − p₀) / 100 mm.

    They are fitted to both markers in all frames by least squares. Each row W of eq. (18) has the
    weight w = 1/ẑ², with ẑ the estimated depth. The fit is the steady state of rule (21) for
    Γ = (Σ w WᵀW + Γ₀⁻¹)⁻¹, with Γ₀ the prior covariance, about any origin p₀. Ĵ is eq. (15) with
    ∂m/∂p₁ of the fit.

    Notes
    -----
    It has no settings. It estimates the imaged RCM, averages the noise of the markers, and accepts
    frames with one lost marker. The RCM may lie in front of the camera, behind it or in its focal
    plane.

    References
    ----------
    Section III-B of the paper; Y. I. Abdel-Aziz and H. M. Karara (1971) for the direct linear
    transformation.
    """

    name = "dlt"
    predicts_markers = True
    estimates_rcm = True
    tolerates_lost_marker = True
    kernel = DltKernel()

    def init(self) -> Rows[ProjectionFit]:
        return initial_fit().rows

    def update(
        self, memory: Rows[ProjectionFit], tool: Tool, sample: Sample
    ) -> Rows[ProjectionFit]:
        memory = memory.copy()
        update_fit(memory[0], sample.p1, sample.points, tool.struct)
        return memory

    def jacobian(self, memory: Rows[ProjectionFit], tool: Tool, sample: Sample) -> Floats:
        p1, points, o_c, *_ = sample
        return fitted_features_jacobian(memory[0], p1, points, o_c, tool.struct)

    def filtered_markers(self, memory: Rows[ProjectionFit], tool: Tool, sample: Sample) -> Floats:
        return filter_markers(memory[0], sample.p1, tool.struct)

    def markers_jacobian(self, memory: Rows[ProjectionFit], tool: Tool, sample: Sample) -> Floats:
        return markers_jacobian(memory[0], sample.p1, tool.struct)

    def imaged_rcm(self, memory: Rows[ProjectionFit]) -> tuple[Floats, Floats]:
        return predict_image(memory[0], RCM_POSITION_MM)

    def predict(self, memory: Rows[ProjectionFit], tool: Tool, p1: Floats) -> Floats:
        o_c, both = (
            predict_image(memory[0], RCM_POSITION_MM)[0],
            (p1.copy(), tool.second_marker(p1)),
        )
        return np.concatenate([predict_image(memory[0], p)[0] - o_c for p in both])

    def recorded_numbers(self, memory: Any) -> Floats:
        known = ProjectionFit(memory)
        numbers = (
            known.A.ravel(),
            known.g,
            known.origin,
            known.offset.ravel(),
            [known.noise_variance],
        )
        return np.concatenate(numbers)
