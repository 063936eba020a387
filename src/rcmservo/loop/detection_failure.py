"""Reason for undetected markers, as text for the operator."""

from rcmservo.errors import BadInput
from rcmservo.interfaces import DropReason, FailureExplainer, Frame, Observation
from rcmservo.loop.plant import MAX_FRAME_AGE_NS, Plant

CAMERA_SILENCE_S = 0.5
"""Time in s without a usable frame after which the missing frames are the reported reason."""

MIN_REPORTED_SILENCE_S = 0.1
"""Time in s before which the first frame of a camera may still arrive."""


def explain_undetected_markers(plant: Plant, observation: Observation, began_ns: int) -> str:
    """Return the reason why no markers are detected.

    It is the first of these that applies: the plant does not use the frames that arrive; no frame
    arrives; the tracker's reason for the newest used frame.

    Parameters
    ----------
    plant : Plant
        Plant of the loop.
    observation : Observation
        Newest observation.
    began_ns : int
        Time since which the markers are undetected, ns.

    Returns
    -------
    str
        Reason, without a full stop.
    """
    if observation.drop_reason is not DropReason.NONE:
        return _explain_dropped_frame(plant, observation.drop_reason)
    time_without_frame_s = (observation.now - max(observation.arrival, began_ns)) * 1e-9
    if plant.frame is None and time_without_frame_s < MIN_REPORTED_SILENCE_S:
        return "the camera has delivered no frame yet"
    if plant.frame is None or time_without_frame_s > CAMERA_SILENCE_S:
        return f"the camera has delivered no frame for {time_without_frame_s:.1f} s"
    tracker, tracker_reason = plant.tracker, ""
    if isinstance(tracker, FailureExplainer):
        tracker_reason = tracker.explain_failure(plant.frame)
    return tracker_reason or "both markers must be in the image"


def _explain_dropped_frame(plant: Plant, drop_reason: DropReason) -> str:
    """Return the reason for not using the frames that arrive, with details of the newest one."""
    newest_frame = plant.camera.latest()
    if newest_frame is None:
        return drop_reason.text
    if drop_reason is DropReason.CLOCK:
        detail = _describe_impossible_time(plant, newest_frame)
        return f"{drop_reason.text}: {detail}" if detail else drop_reason.text
    try:
        plant.tracker.find(newest_frame)
    except BadInput as error:
        return str(error)
    return drop_reason.text


def _describe_impossible_time(plant: Plant, newest_frame: Frame) -> str:
    """Return the time of a frame that is impossible, and its range; empty if there is none.

    The time since the arrival comes last, because it grows while a dropped frame is the newest.
    """
    expected = f"expected 0 to {MAX_FRAME_AGE_NS * 1e-9:g} s"
    delay_ns = newest_frame.arrival - newest_frame.exposure
    if not 0 <= delay_ns <= MAX_FRAME_AGE_NS:
        return f"the newest arrived {delay_ns * 1e-9:.3f} s after its exposure; {expected}"
    if plant.frame is not None and newest_frame is not plant.frame:
        interval_ns = newest_frame.exposure - plant.frame.exposure
        if interval_ns <= 0:
            interval = f"{interval_ns * 1e-9:.3f} s after the previous one"
            return f"the newest was exposed {interval}; expected more than 0 s"
    age_ns = plant.clock.now() - newest_frame.arrival
    if not 0 <= age_ns <= MAX_FRAME_AGE_NS:
        return f"the newest arrived {age_ns * 1e-9:.3f} s ago; {expected}"
    return ""
