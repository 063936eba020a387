"""Learning by showing: what the camera sees now becomes the target."""

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant
from rcmservo.loop.shown import TEACHING_FRAMES, TargetFrames, require_frames
from rcmservo.loop.unseen import unseen

TEACH_TIMEOUT = 2.0
"""s without a frame that shows both markers after which teaching gives up."""


class NotShown(RcmServoError):
    """A target that could not be taught, and why."""


def teach(plant: Plant, frames: int = TEACHING_FRAMES) -> Target:
    """Take what the camera sees from now on as the target: the mean over `frames` frames. It never
    moves anything."""
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
            why = shown.why_not()
            if why:
                raise NotShown(f"the target cannot be taught: {why}")
            return shown.target(began)
        if not seen.now - good <= TEACH_TIMEOUT * 1e9:
            break
    raise NotShown(f"the target cannot be taught: {unseen(plant, seen, began)}")
