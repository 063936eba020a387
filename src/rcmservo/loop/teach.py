"""Learning by showing: what the camera sees now becomes the target."""

import numpy as np

from rcmservo.errors import BadInput, RcmServoError, require
from rcmservo.interfaces import Dropped, Explains, Floats, Observation, Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant

TEACH_TIMEOUT = 2.0
"""s without a frame that shows both markers after which teaching gives up."""

SILENCE = 0.5
"""s without a frame after which it is the camera that is to blame."""


class NotShown(RcmServoError):
    """A target that could not be taught, and why."""


def teach(plant: Plant, frames: int = 30) -> Target:
    """Take what the camera sees from now on as the target: the mean over `frames` frames. It never
    moves anything."""
    require(frames >= 1, "frames", frames, "a whole number of at least 1 frames")
    plant.reset()
    points: list[Floats] = []
    joints: list[Floats] = []
    seen = plant.read()
    last, began = seen.frame, plant.clock.now()
    good = began
    for _ in ticks(plant.clock):
        seen = plant.read()
        if seen.frame > last and seen.exposure >= began and np.isfinite(seen.points).all():
            points.append(seen.points)
            joints.append(seen.q)
            good = seen.now
        last = max(last, seen.frame)
        if len(points) == frames:
            return Target(np.mean(points, axis=0), np.mean(joints, axis=0), began)
        if not seen.now - good <= TEACH_TIMEOUT * 1e9:
            break
    raise NotShown(f"the target cannot be taught: {_why(plant, seen, began)}")


def _why(plant: Plant, seen: Observation, began: int) -> str:
    """What kept the markers from being seen."""
    silent = (seen.now - max(seen.arrival, began)) * 1e-9
    if seen.dropped is not Dropped.NONE:
        return _why_dropped(plant, seen.dropped)
    if plant.frame is None or silent > SILENCE:
        return f"no frame has come from the camera for {silent:.1f} s"
    why = plant.tracker.why(plant.frame) if isinstance(plant.tracker, Explains) else ""
    return why or "both markers must be in the picture while it is shown"


def _why_dropped(plant: Plant, dropped: Dropped) -> str:
    """Why frames came but were not used."""
    frame = plant.camera.latest()
    if dropped is Dropped.CLOCK and frame is not None:
        age = (plant.clock.now() - frame.exposure) * 1e-9
        return f"{dropped.value}: the newest is {age:.3f} s old, which must be from 0 to 2 s"
    try:
        if frame is not None:
            plant.tracker.find(frame)
    except BadInput as error:
        return str(error)
    return dropped.value
