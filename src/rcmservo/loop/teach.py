"""Teaching by showing: the present view of the tool becomes the target."""

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.detection_failure import reason_not_detected
from rcmservo.loop.plant import Plant
from rcmservo.loop.target_frames import TEACHING_FRAMES, TargetFrames, require_frames

TEACH_TIMEOUT = 2.0
"""Time in s without a frame that shows both markers after which teaching fails."""


class NotShown(RcmServoError):
    """Target that could not be taught, with the reason."""


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
    """
    require_frames(frames)
    plant.reset()
    shown = TargetFrames()
    seen = plant.read()
    last, began = seen.frame, plant.clock.now()
    good = began
    for _ in ticks(plant.clock):
        seen = plant.read()
        if seen.frame > last and seen.exposure >= began and np.isfinite(seen.points).all():
            shown.add(seen)
            good = seen.now
        last = max(last, seen.frame)
        if len(shown.points) == frames:
            why = shown.disagreement()
            if why:
                raise NotShown(f"the target cannot be taught: {why}")
            return shown.target(began)
        if not seen.now - good <= TEACH_TIMEOUT * 1e9:
            break
    raise NotShown(f"the target cannot be taught: {reason_not_detected(plant, seen, began)}")
