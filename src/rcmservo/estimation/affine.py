"""Estimator by the markers' pixels and apparent sizes, an affine model of both balls.

A ball's pixels divided by its apparent radius are affine in its position (ball_size_fit.py): linear
least squares over all frames gives twelve numbers for each marker. The model needs no RCM in front
of the camera and no sign of a depth, it has no singular pose, and one marker determines the
position. It needs a tracker that measures sizes; without sizes it estimates nothing.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import between
from rcmservo.estimation.ball_size_fit import (
    MIN_FRAMES,
    BallFit,
    ball_jacobian,
    no_balls,
    place_told,
    predict_ball_image,
    project_ball,
    radius_jacobian,
    update_ball_fit,
)
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.projection_fit import RCM_POSITION_MM
from rcmservo.geometry.features import about, features_jacobian
from rcmservo.geometry.tool import Shaft, Tool, second_marker, second_marker_jacobian
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, products, put
from rcmservo.numerics.structs import Rows


@compiled
def see_both(
    memory: Rows[BallFit],
    p1: Floats,
    points: Floats,
    sizes: Floats,
    kappa: float,
    shaft: Shaft,
) -> Rows[BallFit]:
    """Return the fits of both balls after one more frame.

    The frame has the markers' raw `points` (2, 2) px and `sizes` (2,) px, with marker 1 at p1 (3,)
    mm.
    """
    memory = memory.copy()
    update_ball_fit(memory[0], p1, points[0], sizes[0], kappa)
    update_ball_fit(memory[1], second_marker(shaft, p1), points[1], sizes[1], kappa)
    return memory


@compiled
def both_are_fitted(memory: Rows[BallFit]) -> bool:
    """Return whether the fits of both markers have enough frames."""
    return memory[0].frame_count >= MIN_FRAMES and memory[1].frame_count >= MIN_FRAMES


@compiled
def markers_jacobian(memory: Rows[BallFit], p1: Floats, shaft: Shaft) -> Floats:
    """Return ∂m/∂p₁ (4, 3) px/mm of both markers with marker 1 at p1 (3,) mm."""
    jacobian, p2 = np.empty((4, 3)), second_marker(shaft, p1)
    put(jacobian[:2], ball_jacobian(memory[0], p1))
    put(jacobian[2:], products(ball_jacobian(memory[1], p2), second_marker_jacobian(shaft, p1)))
    return jacobian


@compiled
def sizes_motion(memory: Rows[BallFit], p1: Floats, shaft: Shaft) -> Floats:
    """Return ∂R/∂p₁ (2, 3) px/mm of both markers' apparent radii with marker 1 at p1 (3,) mm."""
    jacobian, jacobian_2 = np.empty((2, 3)), np.empty((1, 3))
    put(jacobian[0], radius_jacobian(memory[0], p1))
    put(jacobian_2[0], radius_jacobian(memory[1], second_marker(shaft, p1)))
    put(jacobian[1:], products(jacobian_2, second_marker_jacobian(shaft, p1)))
    return jacobian


@compiled
def sized_jacobian(
    memory: Rows[BallFit], p1: Floats, points: Floats, o_c: Floats, shaft: Shaft
) -> Floats:
    """Return Ĵ (3, 3) of eq. (15), or zeros before both fits have enough frames.

    It is ∂y/∂m at the raw `points` (2, 2) px about o_c, times ∂m/∂p₁ of both fits.
    """
    if not (both_are_fitted(memory) and all_finite(points) and all_finite(o_c)):
        return np.zeros((3, 3))
    J_hat = products(features_jacobian(about(points, o_c)), markers_jacobian(memory, p1, shaft))
    return J_hat if all_finite(J_hat) else np.zeros((3, 3))


@compiled
def sized_markers(memory: Rows[BallFit], p1: Floats, shaft: Shaft) -> Floats:
    """Return the markers (2, 2) raw px that the fits predict for p1 (3,) mm."""
    points, p = np.empty((2, 2)), p1
    for k in range(2):
        image = project_ball(memory[k], p)
        for i in range(2):
            points[k, i] = memory[k].origin[3 + i] + image.m[i]
        p = second_marker(shaft, p1)
    return points


@compiled
def sized_rcm(memory: Rows[BallFit]) -> tuple[Floats, Floats]:
    """Return the imaged RCM (2,) raw px and its covariance (2, 2) px².

    It is that of the fit with the smaller variance.
    """
    o_c_1, covariance_1 = predict_ball_image(memory[0], RCM_POSITION_MM)
    o_c_2, covariance_2 = predict_ball_image(memory[1], RCM_POSITION_MM)
    if covariance_1[0, 0] + covariance_1[1, 1] < covariance_2[0, 0] + covariance_2[1, 1]:
        return o_c_1, covariance_1
    return o_c_2, covariance_2


@dataclass(frozen=True)
class AffineEstimator(Estimator):
    """Estimator of Ĵ by the markers' pixels and apparent sizes.

    The pixels of a ball divided by its apparent radius R are affine in its position p:

        (u, v, 1)/R = C [p 1]

    The matrix C (3, 4) of each marker is fitted to all frames. Ĵ follows from eq. (15).

    Parameters
    ----------
    size_noise : float
        Noise of an apparent radius in px for each px of noise of a centre. It is below 1, as errors
        of the joints move the centres and hardly change the sizes.

    Raises
    ------
    BadInput
        If `size_noise` is outside its range.

    Notes
    -----
    It needs a tracker that measures apparent radii, and four frames at different positions. It
    estimates the imaged RCM and accepts frames with one lost marker. There is no singular pose.

    References
    ----------
    Size times depth is constant for a ball; the method is derived in the module
    `rcmservo.estimation.ball_size_fit`.
    """

    size_noise: Annotated[float, between(0.01, 100.0, "a number of px for a px")] = 0.3

    name = "affine"
    models = True
    places_rcm = True
    spares_marker = True
    advice = "affine needs a tracker that measures the markers' apparent sizes"

    def init(self) -> Rows[BallFit]:
        return no_balls()

    def update(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Rows[BallFit]:
        kappa = 1.0 / self.size_noise**2
        return see_both(memory, sample.p1, sample.points, sample.sizes, kappa, tool.shaft)

    def jacobian(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Floats:
        return sized_jacobian(memory, sample.p1, sample.points, sample.o_c, tool.shaft)

    def located(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Floats:
        is_lost = ~np.isfinite(sample.points)
        return np.where(is_lost, sized_markers(memory, sample.p1, tool.shaft), sample.points)

    def motion(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Floats:
        return markers_jacobian(memory, sample.p1, tool.shaft)

    def size_motion(self, memory: Rows[BallFit], tool: Tool, sample: Sample) -> Floats:
        return sizes_motion(memory, sample.p1, tool.shaft)

    def imaged_rcm(self, memory: Rows[BallFit]) -> tuple[Floats, Floats] | None:
        return sized_rcm(memory) if both_are_fitted(memory) else None

    def predict(self, memory: Rows[BallFit], tool: Tool, p1: Floats) -> Floats | None:
        if not both_are_fitted(memory):
            return None
        o_c = sized_rcm(memory)[0]
        return (sized_markers(memory, p1, tool.shaft) - o_c).ravel()

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
        p, is_known = place_told(memory[k], np.asarray(point, dtype=np.float64), float(size))
        return p if is_known else None
