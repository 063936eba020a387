"""Parameters of the page's process."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcmservo.interfaces import Camera
from rcmservo.page.plots.mechanism_shape import Shape
from rcmservo.page.poses import PoseFolder
from rcmservo.page.settings import Chosen
from rcmservo.page.view_model import Truth
from rcmservo.page.web.access import Doors


@dataclass(frozen=True)
class Site:
    """Parameters of the page's process, passed when it is started.

    Parameters
    ----------
    title : str
        Title of the page.
    camera : Callable[[], Camera]
        Opens the camera whose pictures are displayed.
    access : Doors
        Credentials of the page.
    stop_port : int
        Port of the process that receives STOP.
    selection : Chosen
        Servo with the selected settings.
    poses : PoseFolder
        Folder of stored poses.
    shape : Shape
        Mechanism and tool to draw.
    runs : Path
        Folder of all runs.
    disturbances : tuple[dict[str, Any], ...]
        Disturbances that can be requested; empty outside simulation.
    truth : Truth or None
        True pose error; None outside simulation.
    """

    title: str
    camera: Callable[[], Camera]
    access: Doors
    stop_port: int
    selection: Chosen
    poses: PoseFolder
    shape: Shape
    runs: Path
    disturbances: tuple[dict[str, Any], ...] = ()
    truth: Truth | None = None
