"""What a page is served for."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rcmservo.interfaces import Camera
from rcmservo.page.web.doors import Doors


@dataclass(frozen=True)
class Site:
    """All that the page's process is told when it begins."""

    title: str
    """Of the page."""
    camera: Callable[[], Camera]
    """Opens what the person sees."""
    doors: Doors
    """Who is let in."""
    stop_port: int
    """That of the process that hears STOP."""
    troubles: tuple[dict[str, Any], ...] = ()
    """What can go wrong on request; none but in simulation."""
