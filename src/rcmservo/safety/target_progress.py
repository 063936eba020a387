"""Progress towards the target, as the checks judge it."""

from rcmservo.numerics.structs import Row, flag, real, whole


class TargetProgress(Row):
    """Progress towards the target, as the checks judge it."""

    blocked: int = whole("", "the joint whose limit stands in the way, -1 for none")
    open: float = real("", "share of the error that the damped law works off, 1 where it is small")
    left: float = real("mm", "how far marker 1 is from the target by the picture")
    arrived: bool = flag("whether the joints have been where the target was shown")
    astray: int = whole("ns", "since when it is elsewhere than the target's joints, -1: not so")
    peak: float = real("", "the error √(2V) that has last been fallen short of")
    peak_time: int = whole("ns", "when that was")
    moved: int = whole("ns", "when the camera was last noticed to have been moved, -1: never")
