"""rcmservo: position the tool of a remote-centre-of-motion mechanism from one uncalibrated
camera.
"""

import importlib
from typing import TYPE_CHECKING, Any

from rcmservo.errors import needing

if TYPE_CHECKING:
    from rcmservo.public import *  # noqa: F403

__version__ = "0.2.0"

PUBLIC_PACKAGES = "sim", "study", "tracking"
"""Offered as they are; they need MuJoCo and OpenCV, which the core does not."""

STUDY_NAMES = ("bound",)
"""Offered from `rcmservo.study`, likewise only when they are asked for."""


def __getattr__(name: str) -> Any:
    """Load a public name on its first use, so that the command line starts at once."""
    if name in PUBLIC_PACKAGES:
        with needing(f"rcmservo.{name}", "sim"):
            return importlib.import_module(f"rcmservo.{name}")
    if name in STUDY_NAMES:
        return getattr(importlib.import_module("rcmservo.study"), name)
    public = importlib.import_module("rcmservo.public")
    if name == "__all__" or name in public.__all__:
        return getattr(public, name)
    raise AttributeError(f"module 'rcmservo' has no attribute {name!r}")
