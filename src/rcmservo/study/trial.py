"""Scene, target and noise of one closed loop of a study.

All of them follow from the seed and the repetition, so that methods and engines meet the same
conditions.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.constraints import not_negative
from rcmservo.interfaces import Floats
from rcmservo.sim import RigSettings
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.sim.scene import Scene
from rcmservo.study.kernel_engine import StudyGoal

NOISE_SEED_CHILD = 1
"""Index of the seed's child that the noise is drawn from; its own children are repetitions."""


class StudyTrial(NamedTuple):
    """Scene, target and noise of one closed loop.

    Parameters
    ----------
    scene : Scene
        Scene, which depends on the seed alone.
    goal : StudyGoal
        Target, whose markers are the mean of the frames that it was taught with.
    noise : Floats
        Noise (frames, 2, 2) px of every frame from the first tick on.
    """

    scene: Scene
    goal: StudyGoal
    noise: Floats


def count_frames(settings: RigSettings, duration: float) -> int:
    """Return the largest number of frames in a closed loop of `duration` s."""
    return int(duration * settings.timing.frame_rate) + 2


def draw_trial(
    seed: int, repetition: int, settings: RigSettings, duration: float, teaching_frames: int
) -> StudyTrial:
    """Draw the scene of `Rig(seed)`, and the noise of a repetition.

    Parameters
    ----------
    seed : int
        Seed of the scene.
    repetition : int
        Number of the repetition from 0; each has other noise.
    settings : RigSettings
        The simulated laboratory.
    duration : float
        Length of the closed loop, s.
    teaching_frames : int
        Number of frames whose mean is the target.
    """
    not_negative("whole number").require("repetition", repetition)
    scene, random = sample_scene_of_seed(seed, settings)
    if repetition:
        source = np.random.SeedSequence(seed, spawn_key=(NOISE_SEED_CHILD, repetition - 1))
        random = np.random.default_rng(source)
    sigma, markers = settings.point_noise, scene.body.points(scene.target)[:2]
    mean_noise = random.standard_normal((2, 2)) / np.sqrt(teaching_frames)
    points = scene.optics.project(markers) + sigma * mean_noise
    noise = sigma * random.standard_normal((count_frames(settings, duration), 2, 2))
    q = settings.drive.measured(scene.target)
    return StudyTrial(scene, StudyGoal(points, q, markers[1]), noise)
