"""Reason for undetected markers, as a sentence for the operator."""

from rcmservo.errors import BadInput
from rcmservo.interfaces import DropReason, FailureExplainer, Observation
from rcmservo.loop.plant import Plant

FRAME_TIMEOUT_S = 0.5
"""Time in s without a frame after which the camera is reported as the reason."""


def explain_undetected_markers(plant: Plant, observation: Observation, began: int) -> str:
    """Return the reason for undetected markers since `began` ns.

    The reason is missing frames, unusable frames, or that of the tracker for the newest frame.
    """
    silence_s = (observation.now - max(observation.arrival, began)) * 1e-9
    if observation.drop_reason is not DropReason.NONE:
        return _explain_dropped_frame(plant, observation.drop_reason)
    if plant.frame is None or silence_s > FRAME_TIMEOUT_S:
        return f"the camera has delivered no frame for {silence_s:.1f} s"
    tracker = plant.tracker
    reason = tracker.explain_failure(plant.frame) if isinstance(tracker, FailureExplainer) else ""
    return reason or "both markers must be in the image"


def _explain_dropped_frame(plant: Plant, drop_reason: DropReason) -> str:
    """Return the reason for not using the frames that arrived, with details of the newest one."""
    frame = plant.camera.latest()
    if frame is None:
        return drop_reason.text
    if drop_reason is DropReason.CLOCK:
        age_s = (plant.clock.now() - frame.exposure) * 1e-9
        return f"{drop_reason.text}: the newest is {age_s:.3f} s old, expected 0 to 2 s"
    try:
        plant.tracker.find(frame)
    except BadInput as error:
        return str(error)
    return drop_reason.text
