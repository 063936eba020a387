"""Scenes, estimators, explorations and controllers that several experiments share.

The gains are the paper's. The scenes have its initial errors.
"""

from dataclasses import replace

import numpy as np

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR, ProjectionEstimator
from rcmservo.safety.gate import Gate
from rcmservo.sim import SceneSettings

TEACHING_FRAMES = 30
"""Frames over which a taught target is averaged; the numbers of the claims depend on it."""

PAPER_CONTROLLER = SaturatedController(
    gain=0.1, bounds=(float(np.radians(10.0)), 10.0, 10.0), joint_trust=0.0
)
"""Controller (31)-(32) with the paper's k = 0.1 and b = (10°, 10 px, 10 px)."""

FAST_CONTROLLER = SaturatedController(gain=2.0, joint_trust=0.0)
"""Controller (31)-(32) with k = 2 and the default b."""

FAST_ESTIMATOR = ProjectionEstimator()
"""The paper's projection-based estimator (21) with the fast Γ, on both markers."""

SLOW_ESTIMATOR = PAPER_PROJECTION_ESTIMATOR
"""The same estimator with the paper's Γ, and 10⁴ s of estimator time for each fit."""

EQUAL_ROUNDS = Exploration(leg_time=1.0, speed_scale=0.12, growth=1.0, max_time=60.0)
"""Exploration in equal rounds at about 30 mm/s with `FAST_ARM`; `reach` alone sets their size."""

PROJECTION_EXPLORATION = replace(EQUAL_ROUNDS, max_leg_length=17.0, min_corners=8)
"""Exploration for the printed fit: ten noisy observations of one marker need two rounds of 17
mm."""

PAPER_SCENES = SceneSettings(
    errors=(float(np.radians(40.0)), -80.0, -60.0),
    insertion=(40.0, 70.0),
    distance=(150.0, 400.0),
    room=17.0,
)
"""Scenes of the regulation experiments, with initial errors of exactly [40°, 80 px, 60 px].

r and d grow on the path to the target. The insertion is short and the camera far, so that the
imaged tool can rotate by 40° within the image.
"""

FLOW_ESTIMATOR = FlowEstimator(gamma=0.001)
"""The paper's flow-based estimator."""

FLOW_EXPLORATION = replace(EQUAL_ROUNDS, max_leg_length=12.0, min_corners=60, tolerance=0.2)
"""Exploration for the flow rule, which converges as 1 − exp(−γ v L): about 20 s of motion."""

PAPER_METHODS: dict[str, tuple[Estimator, Exploration]] = {
    "projection": (SLOW_ESTIMATOR, PROJECTION_EXPLORATION),
    "flow": (FLOW_ESTIMATOR, FLOW_EXPLORATION),
}
"""The paper's estimators, each with its exploration."""

FAST_ARM = Gate(speed=(2.0, 2.0, 160.0), slew=(20.0, 20.0, 1600.0))
"""Limits of a fast arm: an exploration at 30 mm/s uses no more than its permitted fraction of the
speed."""

POINT_NOISE_PX = 0.1
"""Standard deviation (px) of the markers of a camera without images, about that of tracking in
rendered frames."""

PAPER_MAX_POSE_ERROR_MM = 4.0
"""Largest pose error (mm) that the paper states."""


def remove_limits(exploration: Exploration) -> Exploration:
    """Return the same exploration without a limit on legs and time."""
    return replace(exploration, min_corners=1000, max_time=1e6)
