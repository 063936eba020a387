"""Scene, target and noise of one closed loop of a study, and the base of the engines that run it.

Scene, target and noise follow from the seed and the repetition, so that all methods and engines
meet the same conditions.
"""

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from rcmservo.constraints import Checked, not_negative, positive
from rcmservo.interfaces import Floats
from rcmservo.loop.target_frames import FRAME_COUNT, TEACHING_FRAMES
from rcmservo.servo.servo import Servo
from rcmservo.sim import RigSettings
from rcmservo.sim.cameras import step_air
from rcmservo.sim.cramer_rao import bound
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.sim.scene import Scene
from rcmservo.study.kernel_engine import StudyGoal

FIRST_TICK_NS = 1_000_000_000
"""Time of the first tick on the clock of the plant, ns."""

NOISE_SEED_CHILD = 1
"""Child of the seed that the noise is drawn from; each repetition is a child of this child."""


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
    """Draw the scene of `Rig(seed)`, and the target and noise of a repetition.

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
    noise_px, body = settings.point_noise, settings.make_body(seed)
    errors, air = body.imperfections, settings.imperfections.air
    markers = body.points(scene.target + errors.target_in_gap * errors.half_gap)[:2]
    mean_noise = random.standard_normal((2, 2)) / np.sqrt(teaching_frames)
    points = scene.optics.project(markers) + noise_px * mean_noise
    frame_noise = noise_px * random.standard_normal((count_frames(settings, duration), 2, 2))
    if air > 0.0:
        rate = settings.timing.frame_rate
        frame_noise = frame_noise + draw_air(air, rate, len(frame_noise), random)
        points = points + draw_air(air, rate, teaching_frames, random).mean(axis=0)
    q = settings.drive.measured(scene.target)
    return StudyTrial(scene, StudyGoal(points, q, markers[1]), frame_noise)


def draw_air(air: float, rate: float, frames: int, random: np.random.Generator) -> Floats:
    """Return the slow motion (frames, 2, 2) px of the markers in successive frames."""
    motion = [air * random.standard_normal((2, 2))]
    while len(motion) < frames:
        motion.append(step_air(motion[-1], air, 1.0 / rate, random))
    return np.array(motion)


@dataclass(frozen=True)
class StudyEngine(Checked):
    """Base of the engines of a study: one servo in one simulated laboratory.

    Parameters
    ----------
    servo : Servo
        The servo.
    settings : RigSettings
        The simulated laboratory: arm, camera and distribution of scenes.
    duration : float
        Length of each closed loop, s.
    teaching_frames : int
        Number of frames whose mean is the target.
    """

    servo: Servo
    settings: RigSettings = field(default_factory=RigSettings)
    duration: Annotated[float, positive("time in s")] = 15.0
    teaching_frames: Annotated[int, FRAME_COUNT] = TEACHING_FRAMES

    @property
    def frame_count(self) -> int:
        """Largest number of frames in a closed loop."""
        return count_frames(self.settings, self.duration)

    def draw_trial(self, seed: int, repetition: int) -> StudyTrial:
        """Draw the scene of `Rig(seed)`, and the noise of a repetition."""
        return draw_trial(seed, repetition, self.settings, self.duration, self.teaching_frames)

    def compute_bound(self, scene: Scene) -> float:
        """Return the Cramér-Rao bound of the pose error for all frames of a loop, rms in mm."""
        noise_px = self.settings.point_noise
        return bound(scene, noise_px, self.frame_count, self.teaching_frames).rms
