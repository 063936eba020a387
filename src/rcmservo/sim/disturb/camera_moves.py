"""Where the camera stands after somebody bumped into it or rolled it."""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.optics import Optics

TRIES = 20
"""Bumps that are tried until both markers stay in the picture."""

BORDER = 15.0
"""px that both markers keep from the picture's border, if a bump lets them."""

SHAKE = 0.5
"""mm by which a bumped camera is displaced. It is turned as well."""


def bumped(optics: Optics, markers: Floats, px: float, random: np.random.Generator) -> Optics:
    """The camera turned in some direction, so that the picture jumps by about `px`.

    It goes on showing the `markers` (2, 3) mm if that can be.
    """
    turned = optics
    for _ in range(TRIES):
        way = random.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(way), np.sin(way), 0.2 * random.standard_normal()])
        rotation = _turn(axis, np.arctan(px / optics.focal)) @ optics.rotation
        shake = SHAKE * min(px / 10.0, 1.0) * random.standard_normal(3) / np.sqrt(3.0)
        turned = replace(optics, rotation=rotation, position=optics.position + shake)
        if _shows(turned, markers):
            break
    return turned


def rolled(optics: Optics, markers: Floats, angle: float) -> Optics:
    """The camera turned by `angle` rad about its line of sight.

    Should one of the `markers` (2, 3) mm leave the picture, it is turned about the line to their
    middle instead.
    """
    to_tool = optics.rotation @ (markers.mean(axis=0) - optics.position)
    about_axis, about_tool = (
        replace(optics, rotation=_turn(axis, angle) @ optics.rotation)
        for axis in (np.array([0.0, 0.0, 1.0]), to_tool)
    )
    return about_axis if _shows(about_axis, markers) else about_tool


def _shows(optics: Optics, markers: Floats) -> bool:
    """Whether both markers are in the picture, away from its border."""
    seen = optics.project(markers)
    return bool(((seen > BORDER) & (seen < np.array([optics.width, optics.height]) - BORDER)).all())


def _turn(axis: Floats, angle: float) -> Floats:
    """The rotation (3, 3) by `angle` rad about an axis (3,): Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
