"""Backlash of the joints, and repeatability of a pose, from the views at rest of all motions.

The encoders at the motors do not show backlash, but the markers do. The fit of the camera to all
views determines it. Two views of one pose show how well the pose is repeated: all joints have
approached it from below, and one joint has moved up, down and back between them. If S (px per rad
or mm) is the motion of the markers per joint motion, and the markers differ by d more than the
encoders explain, the joint has missed its pose by Sᵀd / SᵀS.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.identification import BACKLASH, MarkerViews, identify
from rcmservo.bringup.observations import JointMotion, StillView
from rcmservo.interfaces import Floats

MIN_SIGMAS = 4.0
"""Backlash in standard deviations from which it counts as measured."""


@dataclass(frozen=True)
class Backlash:
    """Backlash of one joint.

    Parameters
    ----------
    joint : int
        Index of the joint.
    size : float
        Lost motion when the joint turns back, rad or mm.
    deviation : float
        Standard deviation of `size` by the noise of the markers, rad or mm.
    repeatability : float
        Difference between two approaches to a pose from the same side (rms), rad or mm.
    """

    joint: int
    size: float
    deviation: float
    repeatability: float

    @property
    def is_measured(self) -> bool:
        """True if noise does not explain it."""
        return self.size > MIN_SIGMAS * self.deviation


def measure_backlash(
    robot: Robot, views: MarkerViews, motions: Sequence[JointMotion]
) -> list[Backlash]:
    """Return the backlash of each joint, for a correct rig file.

    Parameters
    ----------
    robot
        Arm as the rig file describes it.
    views
        Joints and markers at rest.
    motions
        Motions after every joint has taken up its backlash, in their order.
    """
    fit = identify(robot.mechanism, robot.tool, views)
    sizes, deviations = fit.x[BACKLASH], np.sqrt(np.diag(fit.covariance)[BACKLASH])
    S = fit_marker_motion(views)
    return [
        Backlash(
            joint,
            float(sizes[joint]),
            float(deviations[joint]),
            compute_repeatability(motions, joint, S),
        )
        for joint in range(3)
    ]


def fit_marker_motion(views: MarkerViews) -> Floats:
    """Return the motion S (3, 4) of the markers in px per rad, rad, mm, by a linear fit."""
    regressors = np.hstack([views.q - views.q[0], views.descended, np.ones((len(views.q), 1))])
    S: Floats = np.linalg.lstsq(regressors, views.points.reshape(-1, 4))[0].astype(np.float64)
    return S[:3]


def compute_repeatability(motions: Sequence[JointMotion], joint: int, S: Floats) -> float:
    """Return the rms difference (rad or mm) of the poses before and after motions of a joint."""
    ends = [(motion.joint, motion.views[-1]) for motion in motions]
    pairs = [(old, new) for (_, old), (moved, new) in pairwise(ends) if moved == joint]
    misses = [compute_unseen_pixels(old, new, S) @ S[joint] for old, new in pairs]
    return float(np.sqrt(np.mean(np.square(misses)))) / float(S[joint] @ S[joint])


def compute_unseen_pixels(old: StillView, new: StillView, S: Floats) -> Floats:
    """Return the motion (4,) of the markers in px that the encoders do not explain."""
    return (new.points - old.points).ravel() - (new.q - old.q) @ S
