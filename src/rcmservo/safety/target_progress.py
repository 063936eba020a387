"""Progress towards the target, as the checks read it."""

from rcmservo.numerics.structs import Row, flag, real, whole


class TargetProgress(Row):
    """Progress towards the target, as the checks read it."""

    blocked_joint: int = whole("", "index of the joint whose limit blocks the path, -1 for none")
    reducible_fraction: float = real(
        "", "fraction of the error that the damped law reduces, 1 where it is small"
    )
    remaining_mm: float = real("mm", "distance of marker 1 from the target by the image")
    has_arrived: bool = flag("True if the joints have reached the values of the taught target")
    mismatch_since: int = whole(
        "ns", "start of the disagreement of image and joints at the target, -1: none"
    )
    reference_error: float = real("", "error √(2V) from which the next decrease is measured")
    reference_time: int = whole("ns", "time of this error")
    camera_moved_at: int = whole(
        "ns", "time at which a moved camera was last detected, -1 for never"
    )
