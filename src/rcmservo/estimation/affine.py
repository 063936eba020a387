"""Estimator of Ĵ by the markers' pixels and apparent sizes, with an affine model of each marker.

The markers are balls. A ball's pixels divided by its apparent radius are affine in its position
(ball_size_fit.py): linear least squares over all frames gives twelve numbers for each marker. The
RCM may lie anywhere relative to the camera, no pose is singular, and one marker determines the
position of the tool. The tracker must measure sizes; without sizes nothing is estimated.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import between
from rcmservo.estimation.ball_size_fit import (
    MIN_FRAMES,
    BallFit,
    compute_ball_jacobian,
    compute_radius_jacobian,
    locate_ball,
    make_initial_ball_fits,
    predict_ball_image,
    project_ball,
    update_ball_fit,
)
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.camera_fit import RCM_POSITION_MM
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm
from rcmservo.geometry.tool import (
    Tool,
    ToolStruct,
    compute_second_marker,
    compute_second_marker_jacobian,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, copy_into, multiply_matrices
from rcmservo.numerics.structs import Rows


@dataclass(frozen=True)
class AffineEstimator(Estimator):
    """Estimator of Ĵ by the markers' pixels and apparent sizes.

    The markers are balls. The pixels (u, v) of a ball divided by its apparent radius R px are
    affine in its position p (3,) mm:

        (u, v, 1)/R = C [p 1]

    The matrix C (3, 4) of each marker is fitted to all frames. Ĵ (3, 3) in rad/mm, px/mm, px/mm is
    ∂y/∂m ∂m/∂p₁, eq. (15), with ∂m/∂p₁ (4, 3) px/mm of both fits.

    The fit has other origins: with the position p₀ and the pixels (u₀, v₀) of the marker in its
    first frame it is (u − u₀, v − v₀, 1)/R = B x̄, x̄ = [x 1] and x = (p − p₀)/100 mm. The rows b₁,
    b₂, b₃ of B (3, 4), from which C follows, minimise a sum over the frames of one marker, in px²,

        Σ R² [(b₁ᵀx̄ − (u − u₀) b₃ᵀx̄)² + (b₂ᵀx̄ − (v − v₀) b₃ᵀx̄)²] + κ Σ R⁴ (b₃ᵀx̄ − 1/R)²

    with κ = 1/size_noise².

    Parameters
    ----------
    size_noise : float
        Noise of an apparent radius in px for each px of noise of a centre, from 0.01 to 100. The
        default is below 1, as errors of the joints move the centres and hardly change the sizes.

    Raises
    ------
    BadInput
        If `size_noise` is outside its range.

    Notes
    -----
    It needs a tracker that measures apparent radii, and four frames at different positions. Frames
    without radii are ignored: Ĵ stays zero, and the exploration ends with the cause NOT_EXPLORED.
    It accepts frames with one lost marker. No pose is singular. The fit subtracts the bias that the
    noise of the centres causes in b₃.

    The imaged RCM is the image of p = 0. Of the fits of both markers, the one counts whose
    covariance of this image has the smaller trace.

    References
    ----------
    The method is this project's own: size times depth is constant for a ball. The docstring of
    `rcmservo.estimation.ball_size_fit` derives it.
    """

    size_noise: Annotated[float, between(0.01, 100.0, "a number of px for a px")] = 0.3

    name = "affine"
    predicts_markers = True
    estimates_rcm = True
    tolerates_lost_marker = True
    advice = "affine needs a tracker that measures the markers' apparent sizes"

    def init(self) -> Rows[BallFit]:
        """Return the fits of both markers before the first frame."""
        return make_initial_ball_fits()

    def update(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Rows[BallFit]:
        """Return the fits of both markers after one new frame."""
        kappa = 1.0 / self.size_noise**2
        return update_both_fits(memory, sample.p1, sample.points, sample.sizes, kappa, tool.struct)

    def jacobian(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Floats:
        """Return Ĵ (3, 3) of eq. (15) by both fits; zeros before each has four frames."""
        p1, points, o_c, *_ = sample
        return compute_fitted_features_jacobian(memory, p1, points, o_c, tool.struct)

    def filtered_markers(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Floats:
        """Return the measured markers (2, 2) in raw px, a lost one as its fit predicts it."""
        is_lost = ~np.isfinite(sample.points)
        return np.where(is_lost, predict_markers(memory, sample.p1, tool.struct), sample.points)

    def markers_jacobian(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Floats:
        """Return ∂m/∂p₁ (4, 3) in px/mm of both markers by their fits."""
        return compute_markers_jacobian(memory, sample.p1, tool.struct)

    def sizes_jacobian(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Floats:
        """Return ∂R/∂p₁ (2, 3) in px/mm of both apparent radii by their fits."""
        return compute_sizes_jacobian(memory, sample.p1, tool.struct)

    def imaged_rcm(self, memory: Rows[BallFit]) -> tuple[Floats, Floats] | None:
        """Return the image of p = 0, o_c (2,) in raw px, and its covariance (2, 2) in px².

        The result is None before the fit of each marker has four frames.
        """
        return estimate_imaged_rcm(memory) if both_are_fitted(memory) else None

    def predict(self, memory: Rows[BallFit], tool: Tool, p1: Floats) -> Floats | None:
        """Return the markers m (4,) in px from o_c that both fits predict for p₁ (3,) mm.

        The result is None before the fit of each marker has four frames.
        """
        if not both_are_fitted(memory):
            return None
        o_c = estimate_imaged_rcm(memory)[0]
        return (predict_markers(memory, p1, tool.struct) - o_c).ravel()

    def position(self, memory: Rows[BallFit], k: int, point: Floats, size: float) -> Floats | None:
        """Return the position of one marker by its pixels and its apparent radius.

        It solves (u, v, 1)/R = C [p 1] for p.

        Parameters
        ----------
        memory : Rows of BallFit
            Memory after the newest frame.
        k : int
            Index of the marker, 0 or 1.
        point : Floats
            Centre (2,) of the marker in raw px.
        size : float
            Apparent radius of the marker in px.

        Returns
        -------
        Floats or None
            p (3,) mm; None if the fit does not determine it.
        """
        p, is_known = locate_ball(memory[k], np.asarray(point, dtype=np.float64), float(size))
        return p if is_known else None


@compiled
def update_both_fits(
    memory: Rows[BallFit],
    p1: Floats,
    points: Floats,
    sizes: Floats,
    kappa: float,
    shaft: ToolStruct,
) -> Rows[BallFit]:
    """Return the fits of both balls after one more frame.

    The frame has the markers' raw `points` (2, 2) px and `sizes` (2,) px, with marker 1 at p1 (3,)
    mm.
    """
    memory = memory.copy()
    update_ball_fit(memory[0], p1, points[0], sizes[0], kappa)
    update_ball_fit(memory[1], compute_second_marker(shaft, p1), points[1], sizes[1], kappa)
    return memory


@compiled
def both_are_fitted(memory: Rows[BallFit]) -> bool:
    """Return whether the fits of both markers have enough frames."""
    return memory[0].frame_count >= MIN_FRAMES and memory[1].frame_count >= MIN_FRAMES


@compiled
def compute_markers_jacobian(memory: Rows[BallFit], p1: Floats, shaft: ToolStruct) -> Floats:
    """Return ∂m/∂p₁ (4, 3) px/mm of both markers with marker 1 at p1 (3,) mm."""
    jacobian, p2 = np.empty((4, 3)), compute_second_marker(shaft, p1)
    copy_into(jacobian[:2], compute_ball_jacobian(memory[0], p1))
    dm2_dp2 = compute_ball_jacobian(memory[1], p2)
    copy_into(jacobian[2:], multiply_matrices(dm2_dp2, compute_second_marker_jacobian(shaft, p1)))
    return jacobian


@compiled
def compute_sizes_jacobian(memory: Rows[BallFit], p1: Floats, shaft: ToolStruct) -> Floats:
    """Return ∂R/∂p₁ (2, 3) px/mm of both markers' apparent radii with marker 1 at p1 (3,) mm."""
    jacobian, dR2_dp2 = np.empty((2, 3)), np.empty((1, 3))
    copy_into(jacobian[0], compute_radius_jacobian(memory[0], p1))
    copy_into(dR2_dp2[0], compute_radius_jacobian(memory[1], compute_second_marker(shaft, p1)))
    copy_into(jacobian[1:], multiply_matrices(dR2_dp2, compute_second_marker_jacobian(shaft, p1)))
    return jacobian


@compiled
def compute_fitted_features_jacobian(
    memory: Rows[BallFit], p1: Floats, points: Floats, o_c: Floats, shaft: ToolStruct
) -> Floats:
    """Return Ĵ = ∂y/∂m ∂m/∂p₁ (3, 3), eq. (15), or zeros before both fits have enough frames.

    ∂y/∂m is taken at the raw `points` (2, 2) px about o_c, and ∂m/∂p₁ is that of both fits.
    """
    if not (both_are_fitted(memory) and all_finite(points) and all_finite(o_c)):
        return np.zeros((3, 3))
    dy_dm = compute_features_jacobian(shift_to_rcm(points, o_c))
    J_hat = multiply_matrices(dy_dm, compute_markers_jacobian(memory, p1, shaft))
    return J_hat if all_finite(J_hat) else np.zeros((3, 3))


@compiled
def predict_markers(memory: Rows[BallFit], p1: Floats, shaft: ToolStruct) -> Floats:
    """Return the markers (2, 2) raw px that the fits predict for p1 (3,) mm."""
    points, p = np.empty((2, 2)), p1
    for k in range(2):
        image = project_ball(memory[k], p)
        for i in range(2):
            points[k, i] = memory[k].origin[3 + i] + image.m[i]
        p = compute_second_marker(shaft, p1)
    return points


@compiled
def estimate_imaged_rcm(memory: Rows[BallFit]) -> tuple[Floats, Floats]:
    """Return the imaged RCM (2,) raw px and its covariance (2, 2) px² by the more accurate fit."""
    o_c_1, covariance_1 = predict_ball_image(memory[0], RCM_POSITION_MM)
    o_c_2, covariance_2 = predict_ball_image(memory[1], RCM_POSITION_MM)
    if covariance_1[0, 0] + covariance_1[1, 1] < covariance_2[0, 0] + covariance_2[1, 1]:
        return o_c_1, covariance_1
    return o_c_2, covariance_2
