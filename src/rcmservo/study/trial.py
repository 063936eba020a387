"""What one closed loop of a study is given: a scene, the target as it was shown, and the noise of
every frame. All of it comes from the seed and the repetition, so that two methods, and two engines,
are tried on the same.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.constraints import not_negative
from rcmservo.interfaces import Floats
from rcmservo.sim import RigSettings
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.sim.scene import Scene
from rcmservo.study.kernel_engine import Goal

NOISE = 1
"""The child of a scene's seed that its noise is drawn from; its own children are repetitions."""


class StudyTrial(NamedTuple):
    """One scene, one target, one noise.

    Parameters
    ----------
    scene : Scene
        Drawn from the seed alone.
    goal : Goal
        The target, its markers the mean of the frames that it was shown for.
    noise : Floats
        (frames, 2, 2) px, of the frames from the first tick on.
    """

    scene: Scene
    goal: Goal
    noise: Floats


def frames_of(settings: RigSettings, duration: float) -> int:
    """As many frames as a closed loop of so many s may see."""
    return int(duration * settings.timing.frame_rate) + 2


def trial(
    seed: int, repetition: int, settings: RigSettings, duration: float, shown: int
) -> StudyTrial:
    """The trial of a seed: its scene is that of `Rig(seed)`, with other noise in each
    `repetition`.
    """
    not_negative("whole number").require("repetition", repetition)
    scene, random = sample_scene_of_seed(seed, settings)
    if repetition:
        source = np.random.SeedSequence(seed, spawn_key=(NOISE, repetition - 1))
        random = np.random.default_rng(source)
    sigma, markers = settings.point_noise, scene.body.points(scene.target)[:2]
    blur = random.standard_normal((2, 2)) / np.sqrt(shown)
    points = scene.optics.project(markers) + sigma * blur
    noise = sigma * random.standard_normal((frames_of(settings, duration), 2, 2))
    told = settings.drive.measured(scene.target)
    return StudyTrial(scene, Goal(points, told, markers[1]), noise)
