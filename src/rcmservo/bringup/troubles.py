"""Why a motion was ended, in words."""

from rcmservo.bringup.wiring import Finding
from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Floats


class Trouble(RcmServoError):
    """A motion that was ended, with the drive off, and why."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.what)
        self.finding = finding


def went_off(why: str) -> Finding:
    """The drive is off, and nobody here switched it."""
    words = why or "the arm tells no reason"
    return Finding("the drive went off by itself", "arm", words, "on until it is switched off")


def silent_arm(why: str, patience: float) -> Finding:
    """No new answer for `patience` s."""
    words = why or f"no answer for {patience:g} s"
    return Finding("the arm does not answer", "arm", words, "an answer in every tick")


def silent_camera(trouble: str, patience: float) -> Finding:
    """No new frame for `patience` s."""
    words = trouble or f"no frame for {patience:g} s"
    return Finding("no frames come", "camera", words, "frames all the time")


def unseen(seen: int, missed: int) -> Finding:
    """Frames came, and the markers were in too few of them."""
    return Finding(
        "the markers are not seen",
        "markers",
        f"both in {seen} of {seen + missed} frames",
        "both in nearly every frame: light, focus, and the colours in [markers]",
    )


def astray(joint: int, counts: Floats, why: str) -> Finding:
    """A joint that does not do what it is told; how far (3,) all joints went in counts."""
    told = ", ".join(f"{c:+.0f}" for c in counts)
    return Finding(
        f"joint {joint + 1} does not do what it is told: {why}",
        f"joint {joint + 1}",
        f"counts of joints 1, 2, 3: {told}",
        f"counts of joint {joint + 1} alone: look at brake, motor and encoder cables",
    )
