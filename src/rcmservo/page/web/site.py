"""Parameters of the page's process: what the page displays, and from where."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcmservo.interfaces import Camera
from rcmservo.page.plots.mechanism_shape import MechanismShape
from rcmservo.page.poses import PoseFolder
from rcmservo.page.selected_settings import SelectedSettings
from rcmservo.page.view_model import TruePoseError
from rcmservo.page.web.access import PageCredentials


@dataclass(frozen=True)
class Site:
    """Parameters of the page's process, passed when it is started.

    Parameters
    ----------
    title : str
        Title of the page.
    camera : Callable[[], Camera]
        Opens the camera whose pictures are displayed.
    access : PageCredentials
        Credentials of the page.
    stop_port : int
        Port of the process that receives STOP.
    selection : SelectedSettings
        Servo with the selected settings.
    poses : PoseFolder
        Folder of stored poses.
    shape : MechanismShape
        Mechanism and tool to draw.
    runs : Path
        Folder of all runs.
    disturbances : tuple[dict[str, Any], ...]
        Disturbances that can be requested; empty outside simulation.
    truth : TruePoseError or None
        True pose error; None outside simulation.
    """

    title: str
    camera: Callable[[], Camera]
    access: PageCredentials
    stop_port: int
    selection: SelectedSettings
    poses: PoseFolder
    shape: MechanismShape
    runs: Path
    disturbances: tuple[dict[str, Any], ...] = ()
    truth: TruePoseError | None = None
