"""Message for the operator that gives the reason for undetected markers."""

from rcmservo.errors import BadInput
from rcmservo.interfaces import DropReason, FailureExplainer, Observation
from rcmservo.loop.plant import Plant

FRAME_TIMEOUT_S = 0.5
"""Time in s without a frame after which the camera is reported as the reason."""


def reason_not_detected(plant: Plant, observation: Observation, began: int) -> str:
    """Return the reason for undetected markers since `began` ns.

    The reason is missing frames, unusable frames, or that of the tracker for the newest frame.
    """
    silence_s = (observation.now - max(observation.arrival, began)) * 1e-9
    if observation.drop_reason is not DropReason.NONE:
        return _drop_reason(plant, observation.drop_reason)
    if plant.frame is None or silence_s > FRAME_TIMEOUT_S:
        return f"the camera has delivered no frame for {silence_s:.1f} s"
    reason = (
        plant.tracker.explain_failure(plant.frame)
        if isinstance(plant.tracker, FailureExplainer)
        else ""
    )
    return reason or "both markers must be in the image"


def _drop_reason(plant: Plant, dropped: DropReason) -> str:
    """Return the reason for not using the frames that arrived."""
    frame = plant.camera.latest()
    if dropped is DropReason.CLOCK and frame is not None:
        age = (plant.clock.now() - frame.exposure) * 1e-9
        return f"{dropped.text}: the newest is {age:.3f} s old, expected 0 to 2 s"
    try:
        if frame is not None:
            plant.tracker.find(frame)
    except BadInput as error:
        return str(error)
    return dropped.text
