"""Teaching: the present pose of the tool becomes the target."""

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.detection_failure import reason_not_detected
from rcmservo.loop.plant import Plant
from rcmservo.loop.target_frames import TEACHING_FRAMES, TargetFrames, require_frames

TEACH_TIMEOUT_S = 2.0
"""Time in s without a frame that shows both markers after which teaching fails."""


class TeachingFailed(RcmServoError):
    """Failure to teach a target, with its reason."""


def teach(plant: Plant, frames: int = TEACHING_FRAMES) -> Target:
    """Teach a target from the next frames. Nothing moves.

    Parameters
    ----------
    plant : Plant
        Plant whose tool stands at the target.
    frames : int
        Number of frames whose mean becomes the target, 1 to 100 000.

    Returns
    -------
    Target
        Mean raw markers, radii and joint values.

    Raises
    ------
    BadInput
        If the number of frames is out of range.
    NotShown
        If no frame shows both markers for 2 s, or if the frames do not agree.

    References
    ----------
    Section IV-C of the paper: the target is registered from the image at the desired pose.
    """
    require_frames(frames)
    plant.reset()
    frames_so_far = TargetFrames()
    observation = plant.read()
    last, began = observation.frame, plant.clock.now()
    last_detection = began
    for _ in ticks(plant.clock):
        observation = plant.read()
        is_new = observation.frame > last and observation.exposure >= began
        if is_new and np.isfinite(observation.points).all():
            frames_so_far.add(observation)
            last_detection = observation.now
        last = max(last, observation.frame)
        if len(frames_so_far.points) == frames:
            reason = frames_so_far.disagreement()
            if reason:
                raise TeachingFailed(f"the target cannot be taught: {reason}")
            return frames_so_far.target(began)
        if not observation.now - last_detection <= TEACH_TIMEOUT_S * 1e9:
            break
    reason = reason_not_detected(plant, observation, began)
    raise TeachingFailed(f"the target cannot be taught: {reason}")
