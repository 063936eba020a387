"""Ĵ and the tool's place by where the markers are in the picture and how large they are.

A ball's pixels over its apparent radius are affine in its place (ball_size_fit.py): twelve numbers
for each marker, by linear least squares over all frames. It needs no RCM before the camera and no
sign of a depth, has no singular pose, and one marker alone determines the position. It needs a
tracker that measures sizes: without them it estimates nothing.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import between
from rcmservo.estimation.ball_size_fit import (
    ENOUGH,
    SizedBall,
    image_of,
    motion_of,
    no_balls,
    pictured,
    place_told,
    see_ball,
    size_motion_of,
)
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.projection_fit import RCM
from rcmservo.geometry.features import about, features_jacobian
from rcmservo.geometry.tool import Shaft, Tool, second_marker, second_marker_jacobian
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, products, put
from rcmservo.numerics.structs import Rows


@compiled
def see_both(
    memory: Rows[SizedBall],
    p1: Floats,
    points: Floats,
    sizes: Floats,
    kappa: float,
    shaft: Shaft,
) -> Rows[SizedBall]:
    """What is known of both balls after one more frame: raw `points` (2, 2) px and `sizes` (2,) px
    of the markers, with marker 1 at p1 (3,) mm.
    """
    memory = memory.copy()
    see_ball(memory[0], p1, points[0], sizes[0], kappa)
    see_ball(memory[1], second_marker(shaft, p1), points[1], sizes[1], kappa)
    return memory


@compiled
def both_known(memory: Rows[SizedBall]) -> bool:
    """Whether each marker was seen in places enough."""
    return memory[0].frames >= ENOUGH and memory[1].frames >= ENOUGH


@compiled
def sized_motion(memory: Rows[SizedBall], p1: Floats, shaft: Shaft) -> Floats:
    """∂m/∂p₁ (4, 3) px/mm of both markers, with marker 1 at p1 (3,) mm."""
    motion, p2 = np.empty((4, 3)), second_marker(shaft, p1)
    put(motion[:2], motion_of(memory[0], p1))
    put(motion[2:], products(motion_of(memory[1], p2), second_marker_jacobian(shaft, p1)))
    return motion


@compiled
def sizes_motion(memory: Rows[SizedBall], p1: Floats, shaft: Shaft) -> Floats:
    """∂R/∂p₁ (2, 3) px/mm of both markers' apparent radii, with marker 1 at p1 (3,) mm."""
    motion, second = np.empty((2, 3)), np.empty((1, 3))
    put(motion[0], size_motion_of(memory[0], p1))
    put(second[0], size_motion_of(memory[1], second_marker(shaft, p1)))
    put(motion[1:], products(second, second_marker_jacobian(shaft, p1)))
    return motion


@compiled
def sized_jacobian(
    memory: Rows[SizedBall], p1: Floats, points: Floats, o_c: Floats, shaft: Shaft
) -> Floats:
    """Ĵ (3, 3) of eq. (15): ∂y/∂m at raw `points` (2, 2) px about o_c, and ∂m/∂p₁ of both fits;
    zeros while they are not known.
    """
    if not (both_known(memory) and all_finite(points) and all_finite(o_c)):
        return np.zeros((3, 3))
    J_hat = products(features_jacobian(about(points, o_c)), sized_motion(memory, p1, shaft))
    return J_hat if all_finite(J_hat) else np.zeros((3, 3))


@compiled
def sized_markers(memory: Rows[SizedBall], p1: Floats, shaft: Shaft) -> Floats:
    """The markers (2, 2) raw px at p1 (3,) mm by the fits."""
    points, p = np.empty((2, 2)), p1
    for k in range(2):
        there = pictured(memory[k], p)
        for i in range(2):
            points[k, i] = memory[k].origin[3 + i] + there.m[i]
        p = second_marker(shaft, p1)
    return points


@compiled
def sized_rcm(memory: Rows[SizedBall]) -> tuple[Floats, Floats]:
    """The imaged RCM (2,) raw px, and its covariance (2, 2) px², by the fit that tells it
    better.
    """
    first, wide = image_of(memory[0], RCM)
    second, narrow = image_of(memory[1], RCM)
    if wide[0, 0] + wide[1, 1] < narrow[0, 0] + narrow[1, 1]:
        return first, wide
    return second, narrow


@dataclass(frozen=True)
class AffineEstimator(Estimator):
    """Ĵ by the markers' places and apparent sizes. Both are affine in the tool's place.

    Parameters
    ----------
    size_noise : float
        px by which a marker's size is off for every px of its centre. Below 1, as what is wrong
        with the joints moves the centres, and hardly the sizes.
    """

    size_noise: Annotated[float, between(0.01, 100.0, "a number of px for a px")] = 0.3

    name = "affine"
    models = True
    places_rcm = True
    spares_marker = True
    advice = "affine learns from the markers' apparent sizes: it needs a tracker that tells them"

    def init(self) -> Rows[SizedBall]:
        return no_balls()

    def update(self, memory: Rows[SizedBall], tool: Tool, sample: Sample) -> Rows[SizedBall]:
        kappa = 1.0 / self.size_noise**2
        return see_both(memory, sample.p1, sample.points, sample.sizes, kappa, tool.shaft)

    def jacobian(self, memory: Rows[SizedBall], tool: Tool, sample: Sample) -> Floats:
        return sized_jacobian(memory, sample.p1, sample.points, sample.o_c, tool.shaft)

    def located(self, memory: Rows[SizedBall], tool: Tool, sample: Sample) -> Floats:
        lost = ~np.isfinite(sample.points)
        return np.where(lost, sized_markers(memory, sample.p1, tool.shaft), sample.points)

    def motion(self, memory: Rows[SizedBall], tool: Tool, sample: Sample) -> Floats:
        return sized_motion(memory, sample.p1, tool.shaft)

    def size_motion(self, memory: Rows[SizedBall], tool: Tool, sample: Sample) -> Floats:
        return sizes_motion(memory, sample.p1, tool.shaft)

    def imaged_rcm(self, memory: Rows[SizedBall]) -> tuple[Floats, Floats] | None:
        return sized_rcm(memory) if both_known(memory) else None

    def predict(self, memory: Rows[SizedBall], tool: Tool, p1: Floats) -> Floats | None:
        if not both_known(memory):
            return None
        o_c = sized_rcm(memory)[0]
        return (sized_markers(memory, p1, tool.shaft) - o_c).ravel()

    def position(
        self, memory: Rows[SizedBall], k: int, point: Floats, size: float
    ) -> Floats | None:
        """P (3,) mm of marker k (0 or 1) that is seen at a raw `point` (2,) px with an apparent
        radius of `size` px: of (u, v, 1)/R = C [p 1] the p; None where the fit does not tell it.
        """
        p, told = place_told(memory[k], np.asarray(point, dtype=np.float64), float(size))
        return p if told else None
