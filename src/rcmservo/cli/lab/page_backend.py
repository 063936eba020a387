"""Arm and camera that the operator's page controls, simulated or those of a lab."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rcmservo.config.target_file import TargetSetup
from rcmservo.interfaces import Camera
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import SwitchOff
from rcmservo.recording.writer import Recorder
from rcmservo.servo.servo import Servo

if TYPE_CHECKING:
    from rcmservo.page.channels import PageChannels
    from rcmservo.page.selected_settings import SelectedSettings
    from rcmservo.page.view_model import TruePoseError

SESSION_DURATION_S = 3600.0
"""Longest duration of a session in s."""

RECORDED_IMAGES_PER_S = 5.0
"""Images per second in the record of a session."""


@dataclass(frozen=True)
class PageBackend:
    """Arm and camera that the page controls.

    Parameters
    ----------
    title : str
        Title of the page.
    camera : Callable[[], Camera]
        Function that opens the displayed camera in the page's process.
    session : Callable[['PageChannels', Path], Session]
        Function that makes a session, recorded in a new folder.
    switch_off : SwitchOff
        Function that disables the drive from outside the session's process.
    setup : TargetSetup
        Set-up for which a pose holds.
    servo_settings : SelectedSettings
        Servo, whose settings the page may change for later sessions.
    start_disturbance : Callable[[str], str]
        Function that starts a disturbance and returns a sentence on it.
    disturbances : tuple[dict[str, Any], ...]
        Available disturbances.
    truth : TruePoseError | None
        Source of the true pose error, if it is known.
    """

    title: str
    camera: Callable[[], Camera]
    session: Callable[["PageChannels", Path], Session]
    switch_off: SwitchOff
    setup: TargetSetup
    servo_settings: "SelectedSettings"
    start_disturbance: Callable[[str], str]
    disturbances: tuple[dict[str, Any], ...] = ()
    truth: "TruePoseError | None" = None


def open_recorder(path: Path, description: dict[str, Any]) -> Recorder:
    """Open the record of a session in a new folder, once there is something to record."""
    path.parent.mkdir(parents=True)
    return Recorder(path, description)


def describe_enabling(servo: Servo) -> str:
    """Return the announcement of the motion that the page's operator may start."""
    return (
        "Enable switches the drive on, and the servo is paused. Nothing moves until you hold a jog "
        "button or go to a pose. Before the first motion to a pose the tool moves a short distance "
        f"around its start, at most {servo.exploration.max_leg_length:g} mm between two corners of "
        "the path of marker 1."
    )
