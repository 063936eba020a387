"""Estimator of Ĵ by the direct linear transformation: a projection fitted to all frames.

Its memory is the fit of camera_fit.py: the eleven numbers of the projection, their covariance, and
the offset of the markers from the fit. The imaged RCM is the projection of the RCM.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rcmservo.estimation.base import Estimator, EstimatorResult, KernelSample, Sample
from rcmservo.estimation.camera_fit import (
    RCM_POSITION_MM,
    ProjectionFit,
    make_initial_fit,
    update_fit,
)
from rcmservo.estimation.camera_fit_prediction import (
    add_offset,
    compute_fitted_features_jacobian,
    compute_markers_jacobian,
    filter_markers,
    predict_image,
    weigh_markers,
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
    """Write the results that follow from the servo's projection fit.

    The servo has updated the fit before, so the kernel has no memory of its own.
    """
    if sample.fit_changed:
        write_predicted_image(fit, RCM_POSITION_MM, result.o_c, result.o_c_covariance)
    write_predicted_markers(fit, sample.p1, sample.shaft, result.points)
    add_offset(fit, result.points)
    write_markers_jacobian(fit, sample.p1, sample.shaft, result.markers_jacobian)
    result.has_imaged_rcm = True
    return memory


@compiled
def return_empty_memory(kernel: "DltKernel", memory: tuple[()]) -> tuple[()]:
    """Return the memory before the first frame, which is empty."""
    return memory


class DltKernel(NamedTuple):
    """Compiled form of the estimator, as `EstimatorKernel` describes it; it has no settings."""

    estimates_rcm = True
    update = update_kernel
    reset = return_empty_memory


@dataclass(frozen=True)
class DltEstimator(Estimator):
    """Estimator of Ĵ by a projection fitted to all frames.

    The projection of a point p (3,) mm to m (2,) px has eleven numbers, A (2, 4) and g (3,):

        m = m₀ + A x̄ / (1 + gᵀx),    x = (p − p₀) / 100 mm,    x̄ = [x 1]

    p₀ and m₀ are the mean position and the mean pixels of both markers in the first frame. A and g
    minimise the errors of eq. (18) over both markers in all frames,

        Q = ½ Σ w |A x̄ − (1 + gᵀx)(m − m₀)|²,    w = 1/ẑ²

    with the estimated depth ẑ = 1 + gᵀx, which turns the errors into pixels. The minimum is the
    steady state of the paper's rule (21), dθ/dt = −Γ ∂Q/∂θ, for the eleven numbers θ. Ĵ (3, 3) in
    rad/mm, px/mm, px/mm is ∂y/∂m ∂m/∂p₁, eq. (15), with ∂m/∂p₁ (4, 3) px/mm of the fit.

    Notes
    -----
    It has no settings. It averages the noise of the markers and accepts frames with one lost
    marker. The imaged RCM is the projection of p = 0, with the covariance that follows from that of
    A and g. The RCM may lie in front of the camera, behind it or in its focal plane.

    Eleven numbers need six positions of markers that do not lie in one plane, thus three frames or
    more. A prior, equivalent to a standard deviation of 1000 px for A and 1 for g, keeps the fit
    finite before.

    References
    ----------
    Section III-B of the paper; Y. I. Abdel-Aziz and H. M. Karara, Direct linear transformation from
    comparator coordinates into object space coordinates in close-range photogrammetry, Symposium on
    Close-Range Photogrammetry, 1971.
    """

    name = "dlt"
    predicts_markers = True
    estimates_rcm = True
    tolerates_lost_marker = True
    kernel = DltKernel()

    def init(self) -> Rows[ProjectionFit]:
        """Return the fit before the first frame."""
        return make_initial_fit().rows

    def update(
        self, memory: Rows[ProjectionFit], tool: Tool, sample: Sample
    ) -> Rows[ProjectionFit]:
        """Return the fit after one new frame, in which one marker may be lost (NaN)."""
        memory = memory.copy()
        weigh_markers(memory[0], sample.p1, sample.points, tool.struct)
        update_fit(memory[0], sample.p1, sample.points, tool.struct)
        return memory

    def jacobian(self, memory: Rows[ProjectionFit], tool: Tool, sample: Sample) -> Floats:
        """Return Ĵ (3, 3) of eq. (15), ∂y/∂m at the markers of the sample times ∂m/∂p₁."""
        p1, points, o_c, *_ = sample
        return compute_fitted_features_jacobian(memory[0], p1, points, o_c, tool.struct)

    def filtered_markers(self, memory: Rows[ProjectionFit], tool: Tool, sample: Sample) -> Floats:
        """Return the markers (2, 2) in raw px by the fit, which averages their noise."""
        return filter_markers(memory[0], sample.p1, tool.struct)

    def markers_jacobian(self, memory: Rows[ProjectionFit], tool: Tool, sample: Sample) -> Floats:
        """Return ∂m/∂p₁ (4, 3) in px/mm of both markers by the fit."""
        return compute_markers_jacobian(memory[0], sample.p1, tool.struct)

    def imaged_rcm(self, memory: Rows[ProjectionFit]) -> tuple[Floats, Floats]:
        """Return the projection of p = 0, o_c (2,) in raw px, and its covariance (2, 2) in px²."""
        return predict_image(memory[0], RCM_POSITION_MM)

    def predict(self, memory: Rows[ProjectionFit], tool: Tool, p1: Floats) -> Floats:
        """Return the markers m (4,) in px from o_c that the fit predicts for p₁ (3,) mm."""
        o_c = predict_image(memory[0], RCM_POSITION_MM)[0]
        positions = p1.copy(), tool.second_marker(p1)
        return np.concatenate([predict_image(memory[0], p)[0] - o_c for p in positions])

    def recorded_numbers(self, memory: Any) -> Floats:
        """Return the numbers of the fit: A, g, p₀ and m₀, the markers' offsets, noise variance."""
        fit = ProjectionFit(memory)
        arrays = fit.A.ravel(), fit.g, fit.origin, fit.offset.ravel(), [fit.noise_variance]
        return np.concatenate(arrays)
