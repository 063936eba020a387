"""What a page is served for."""

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
    """All that the page's process is told when it begins.

    Parameters
    ----------
    title : str
        Of the page.
    camera : Callable[[], Camera]
        Opens what the person sees.
    doors : Doors
        Who is let in.
    stop_port : int
        That of the process that hears STOP.
    chosen : Chosen
        The servo that can be set.
    poses : PoseFolder
        Where poses are kept.
    shape : Shape
        Of the tool that is drawn.
    runs : Path
        Folder of all runs.
    troubles : tuple[dict[str, Any], ...]
        What can go wrong on request; none but in simulation.
    truth : Truth or None
        Tells the true pose error; None but in simulation.
    """

    title: str
    camera: Callable[[], Camera]
    doors: Doors
    stop_port: int
    chosen: Chosen
    poses: PoseFolder
    shape: Shape
    runs: Path
    disturbances: tuple[dict[str, Any], ...] = ()
    truth: Truth | None = None
