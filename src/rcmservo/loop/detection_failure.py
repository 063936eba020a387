"""Sentence for the operator on why the markers are not detected."""

from rcmservo.errors import BadInput
from rcmservo.interfaces import Dropped, Explains, Observation
from rcmservo.loop.plant import Plant

SILENCE = 0.5
"""Time in s without a frame after which the camera is the reason."""


def reason_not_detected(plant: Plant, seen: Observation, began: int) -> str:
    """Return the reason why no markers were detected since `began` ns: missing or unusable frames,
    or the tracker's reason for the newest frame.
    """
    silent = (seen.now - max(seen.arrival, began)) * 1e-9
    if seen.dropped is not Dropped.NONE:
        return _why_dropped(plant, seen.dropped)
    if plant.frame is None or silent > SILENCE:
        return f"no frame has come from the camera for {silent:.1f} s"
    why = plant.tracker.why(plant.frame) if isinstance(plant.tracker, Explains) else ""
    return why or "both markers must be in the picture"


def _why_dropped(plant: Plant, dropped: Dropped) -> str:
    """Return the reason why frames arrived but were not used."""
    frame = plant.camera.latest()
    if dropped is Dropped.CLOCK and frame is not None:
        age = (plant.clock.now() - frame.exposure) * 1e-9
        return f"{dropped.words}: the newest is {age:.3f} s old, which must be from 0 to 2 s"
    try:
        if frame is not None:
            plant.tracker.find(frame)
    except BadInput as error:
        return str(error)
    return dropped.words
