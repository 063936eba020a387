"""What is behind the operator's page: an arm and its camera, simulated or a laboratory's."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rcmservo.config.target_file import Setup
from rcmservo.interfaces import Camera
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import SwitchOff
from rcmservo.recording.writer import Recorder
from rcmservo.servo.servo import Servo

if TYPE_CHECKING:
    from rcmservo.page.channels import Desk
    from rcmservo.page.settings import Chosen
    from rcmservo.page.view_model import Truth

SESSION_DURATION_S = 3600.0
"""s of a session."""

RECORDED_IMAGES_PER_S = 5.0
"""Pictures that a record gets, 1/s."""


@dataclass(frozen=True)
class Behind:
    """What is behind the page.

    Parameters
    ----------
    title : str
        What it is, in words.
    camera : Callable[[], Camera]
        Opens what the person sees, in the page's process.
    session : Callable[['Desk', Path], Session]
        Makes a session, recorded in a folder that is new.
    off : SwitchOff
        Has the drive switched off from outside of the session's process.
    setup : Setup
        What a pose is bound to.
    chosen : Chosen
        The servo, which the page may set anew for the sessions to come.
    befall : Callable[[str], str]
        Lets something go wrong, and says in words what began.
    troubles : tuple[dict[str, Any], ...]
        What can go wrong.
    truth : Truth | None
        Tells the true pose error, where there is one who knows it.
    """

    title: str
    camera: Callable[[], Camera]
    session: Callable[["Desk", Path], Session]
    off: SwitchOff
    setup: Setup
    chosen: "Chosen"
    befall: Callable[[str], str]
    troubles: tuple[dict[str, Any], ...] = ()
    truth: "Truth | None" = None


def open_recorder(path: Path, words: dict[str, Any]) -> Recorder:
    """The record of a session, in a folder of its own, once there is something to record."""
    path.parent.mkdir(parents=True)
    return Recorder(path, words)


def enable_announcement(servo: Servo) -> str:
    """What happens once the drive is on, as the page's person decides it."""
    return (
        "Enable switches the drive on, and the tool stands, paused. Nothing moves before you hold "
        "a jog button or go to a pose; the first time that goes a little about its start before, "
        f"so that marker 1 goes at most {servo.exploration.reach:g} mm from corner to corner."
    )
