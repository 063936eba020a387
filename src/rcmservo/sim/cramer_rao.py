"""Cramér-Rao bound of the pose error: the smallest error that the pixel noise allows.

A servo has arrived where it measures the same markers as when the target was taught. Both
measurements are noisy: m = h(p) + e, with p (3,) mm the position of marker 2, m (4,) px the pixels
of both markers, and e independent and Gaussian with the standard deviation `noise` in every
coordinate and frame. An unbiased estimator, one whose mean error is zero, that knows camera and
tool and averages n frames has at least the covariance

    noise²/n (HᵀH)⁻¹,    H = ∂h/∂p (4, 3) px/mm.

The pose error is the difference of two such estimates, of the present and of the taught position.
An error of h is common to both and cancels. Near the target the covariance of the pose error is at
least

    Σ = noise² (1/frames + 1/shown) (HᵀH)⁻¹    (3, 3) mm².

H is that of the true camera with its distortion. The bound therefore serves to assess a run, and no
servo may use it. It is that of the image alone: a servo that also uses the joints of teaching can
be below it.

C. R. Rao, "Information and the accuracy attainable in the estimation of statistical parameters",
Bull. Calcutta Math. Soc. 37, 1945; H. Cramér, Mathematical Methods of Statistics, 1946.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.constraints import Limit, not_negative
from rcmservo.geometry.tool import compute_second_marker_jacobian
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_kernels import compute_markers_jacobian
from rcmservo.sim.scene import Scene


@dataclass(frozen=True, eq=False)
class Bound:
    """Cramér-Rao bound of the position error of marker 2, averaged over the noise.

    Parameters
    ----------
    covariance : Floats
        Smallest covariance Σ of the position error (3, 3), mm².
    """

    covariance: Floats

    @property
    def rms(self) -> float:
        """Smallest root mean square length of the error, mm."""
        return float(np.sqrt(np.trace(self.covariance)))


def bound(scene: Scene, noise: float, frames: float, shown: float | None = None) -> Bound:
    """Return the Cramér-Rao bound of the pose error at the target of a scene.

    The bound is Σ = noise² (1/frames + 1/shown) (HᵀH)⁻¹, (3, 3) mm², with H (4, 3) px/mm the
    derivative of both markers' pixels with respect to the position of marker 2. No unbiased
    estimator has a smaller covariance.

    Parameters
    ----------
    scene : Scene
        Camera, tool and target: ``rs.sim.Rig(seed).scene``, or `scene` of a `StudyRun`.
    noise : float
        Standard deviation of a pixel coordinate in a frame, px, not negative.
    frames : float
        Number of frames that the servo averages, at least 1; inf for no noise.
    shown : float or None
        Number of frames whose mean is the target, at least 1; inf for no noise, None for `frames`.

    Returns
    -------
    Bound
        Covariance of the position error of marker 2: `covariance` is Σ (3, 3) in mm², and `rms` is
        √tr Σ in mm, the smallest root mean square length of the error.

    Raises
    ------
    BadInput
        If a number is outside its range.

    Notes
    -----
    H is that of the true camera, which no servo knows. A biased servo can be below the bound.

    References
    ----------
    C. R. Rao, Bull. Calcutta Math. Soc. 37, 1945; H. Cramér, Mathematical Methods of Statistics,
    1946.
    """
    shown = frames if shown is None else shown
    not_negative("number of px").require("noise", noise)
    for name, count in (("frames", frames), ("shown", shown)):
        Limit(lambda n: n >= 1, "at least 1 frame").require(name, count)
    variance = noise**2 * (1.0 / frames + 1.0 / shown)
    H = compute_pixels_jacobian(scene)
    return Bound(np.array(variance * np.linalg.inv(H.T @ H), np.float64))


def compute_pixels_jacobian(scene: Scene) -> Floats:
    """Return H (4, 3) px/mm: derivative of both markers' pixels by the position of marker 2."""
    tool, p1 = scene.body.tool.struct, scene.body.points(scene.target)[0]
    jacobian_by_p1 = compute_markers_jacobian(scene.optics.lens[0], tool, p1)
    return jacobian_by_p1 @ np.linalg.inv(compute_second_marker_jacobian(tool, p1))
