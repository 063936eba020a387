"""Teaching: the present pose of the tool becomes the target of later runs."""

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.detection_failure import explain_undetected_markers
from rcmservo.loop.plant import Plant
from rcmservo.loop.target_frames import FRAME_COUNT, TEACHING_FRAMES, TargetFrames

TEACH_TIMEOUT_S = 2.0
"""Time in s after which teaching fails if no frame shows both markers."""


class TeachingFailed(RcmServoError):
    """Error of a target that cannot be taught, with its reason."""


def teach(plant: Plant, frames: int = TEACHING_FRAMES) -> Target:
    """Teach a target from the next frames. Nothing moves.

    The target is the mean of the markers in raw pixels, over the frames that agree. The desired
    features y_d = (s, r, d) are computed from it at each tick about the present imaged RCM.

    Parameters
    ----------
    plant : Plant
        Plant whose tool stands at the target.
    frames : int
        Number of frames whose mean becomes the target, 1 to 100 000; 300 by default, which are 5 s
        at 60 frames per second.

    Returns
    -------
    Target
        Mean of the markers (2, 2) in raw px, of their radii (2,) in px, and of the joints (3,) in
        rad, rad, mm.

    Raises
    ------
    BadInput
        If the number of frames is out of range, or a device returns an invalid value.
    TeachingFailed
        If no frame shows both markers for 2 s, or if the frames do not agree; the class is in
        `rcmservo.loop.teach`.

    Notes
    -----
    A frame is left out if a coordinate of a marker deviates from the median of all frames by more
    than 6 times the noise, which counts as at least 0.7 px here; ``Target.left_out`` counts these
    frames. The noise is 1.4826 times the median absolute deviation from the median, which is the
    standard deviation of Gaussian noise. The frames do not agree if the noise of a coordinate
    exceeds 2 px, if more than a quarter of them would be left out, or if a joint deviates from its
    median by more than 0.008 rad or 0.6 mm. Only frames that show both markers count.

    An exception of a device reaches the caller, except for a `BadInput` of ``Tracker.find``, which
    only drops the frame.

    References
    ----------
    Section IV-C of the paper: the target is registered from the image at the desired pose.
    """
    FRAME_COUNT.require("frames", frames)
    plant.reset()
    target_frames = TargetFrames()
    observation = plant.read()
    newest_frame, began_ns = observation.frame, plant.clock.now()
    last_detection_ns = began_ns
    for _ in ticks(plant.clock):
        observation = plant.read()
        is_new = observation.frame > newest_frame and observation.exposure >= began_ns
        if is_new and np.isfinite(observation.points).all():
            target_frames.add(observation)
            last_detection_ns = observation.now
        newest_frame = max(newest_frame, observation.frame)
        if len(target_frames.points) == frames:
            disagreement = target_frames.describe_disagreement()
            if disagreement:
                raise TeachingFailed(f"the target cannot be taught: {disagreement}")
            return target_frames.compute_target(began_ns)
        if not observation.now - last_detection_ns <= TEACH_TIMEOUT_S * 1e9:
            break
    reason = explain_undetected_markers(plant, observation, began_ns)
    raise TeachingFailed(f"the target cannot be taught: {reason}")
