"""Position control of a tool in a remote-centre-of-motion mechanism from one uncalibrated camera.

Equation and section numbers in docstrings are those of the paper "Adaptive Image-based Positioning
of RCM Mechanisms Using Angle and Distance Features". Lengths are in mm, image coordinates in px,
angles in rad; pixel (0, 0) is the centre of the top left pixel, u points right and v down. Row 0 of
two markers is marker 1, the one nearer the RCM. "Raw" pixels are image coordinates; m is relative
to the imaged RCM o_c. y = [s r d] in rad, px, px are the angle of the imaged tool, the distance of
marker 1 from o_c and the distance between the markers.

The public names are those of `rcmservo.public`, loaded on first use.
"""

import importlib
from typing import TYPE_CHECKING, Any

from rcmservo.errors import require_extra

if TYPE_CHECKING:
    from rcmservo.public import *  # noqa: F403

__version__ = "0.2.0"

PUBLIC_PACKAGES = "sim", "study", "tracking"
"""Packages that are public as they are. They need MuJoCo or OpenCV, which the core does not."""

STUDY_NAMES = "bound", "compare"
"""Public names of `rcmservo.study`, which are also loaded on first use."""


def __dir__() -> list[str]:
    """Return the public names."""
    public = importlib.import_module("rcmservo.public")
    return sorted([*public.__all__, *PUBLIC_PACKAGES, *STUDY_NAMES, "__version__"])


def __getattr__(name: str) -> Any:
    """Load a public name on first use, so that the command line starts quickly."""
    if name in PUBLIC_PACKAGES:
        with require_extra(f"rcmservo.{name}", "sim"):
            return importlib.import_module(f"rcmservo.{name}")
    if name in STUDY_NAMES:
        return getattr(importlib.import_module("rcmservo.study"), name)
    public = importlib.import_module("rcmservo.public")
    if name == "__all__" or name in public.__all__:
        return getattr(public, name)
    raise AttributeError(f"module 'rcmservo' has no attribute {name!r}")
