"""The least error that pixels allow: the Cramér-Rao bound of the pose in which a servo arrives.

A servo has arrived where the markers are seen as they were shown. Both are known with noise only:
m = h(p) + e, with p (3,) mm the position of marker 2, m (4,) px both markers' pixels, e
independent and Gaussian with the standard deviation `noise` in every coordinate and frame. Whoever
knows camera and tool, and takes the mean of n frames, can tell p without bias to the covariance

    noise²/n (HᵀH)⁻¹,    H = ∂h/∂p (4, 3) px/mm,

and no better. The error is the difference of two such poses, what is seen and what was shown, and
what is wrong with h is in both alike. Near the target it has at least the covariance

    Σ = noise² (1/frames + 1/shown) (HᵀH)⁻¹    (3, 3) mm².

H is that of the true camera, distortion included, so this is for the judge of a run, never for a
servo. A servo that knows beforehand where the target may be (a biased one) can come below it.

C. R. Rao, "Information and the accuracy attainable in the estimation of statistical parameters",
Bull. Calcutta Math. Soc. 37, 1945; H. Cramér, Mathematical Methods of Statistics, 1946.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.constraints import Limit, not_negative
from rcmservo.geometry.tool import second_marker_jacobian
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_kernels import compute_markers_jacobian
from rcmservo.sim.scene import Scene


@dataclass(frozen=True, eq=False)
class Bound:
    """How near to the target marker 2 can come, on an average over the noise.

    Parameters
    ----------
    covariance : Floats
        Σ (3, 3) mm² of its position error.
    """

    covariance: Floats

    @property
    def rms(self) -> float:
        """mm: the root of the mean square of the error's length."""
        return float(np.sqrt(np.trace(self.covariance)))


def bound(scene: Scene, noise: float, frames: float, shown: float | None = None) -> Bound:
    """The Cramér-Rao bound at a scene's target.

    `noise` is the standard deviation of every pixel coordinate in every frame, px. The servo's own
    markers are the mean of the last `frames` frames, the target's that of `shown` frames, of as
    many if that is None. Infinitely many tell of one side without noise.
    """
    shown = frames if shown is None else shown
    not_negative("number of px").require("noise", noise)
    Limit(lambda count: count >= 1, "at least 1 frame").require("frames", frames)
    Limit(lambda count: count >= 1, "at least 1 frame").require("shown", shown)
    variance = noise**2 * (1.0 / frames + 1.0 / shown)
    H = pixels_jacobian(scene)
    return Bound(np.array(variance * np.linalg.inv(H.T @ H), np.float64))


def pixels_jacobian(scene: Scene) -> Floats:
    """H (4, 3) px/mm: the derivative of both markers' pixels by the position of marker 2, at the
    target.
    """
    shaft, p1 = scene.body.tool.shaft, scene.body.points(scene.target)[0]
    by_p1 = compute_markers_jacobian(scene.optics.lens[0], shaft, p1)
    return by_p1 @ np.linalg.inv(second_marker_jacobian(shaft, p1))
