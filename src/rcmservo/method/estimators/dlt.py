"""Recursive direct linear transformation: Ĵ through the whole projection, fitted to all frames and
both markers.

What it remembers is what the camera should see (prospect.py): eleven numbers, their covariance, and
the offset that the fit leaves over. The imaged RCM is one of its results.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.foresight import both_motions, features_motion, imaged, located
from rcmservo.method.prospect import RCM, Prospect, blank, see
from rcmservo.method.tool import Shaft, Tool
from rcmservo.rows import Rows


@compiled
def update(memory: Rows[Prospect], p1: Floats, points: Floats, shaft: Shaft) -> Rows[Prospect]:
    """What the camera should see after one more frame: raw `points` (2, 2) px of the markers, with
    marker 1 at p1 (3,) mm."""
    memory = memory.copy()
    see(memory[0], p1, points, shaft)
    return memory


@compiled
def jacobian_at(
    memory: Rows[Prospect], p1: Floats, points: Floats, o_c: Floats, shaft: Shaft
) -> Floats:
    """Ĵ (3, 3) of eq. (15): ∂y/∂m at raw `points` (2, 2) px about o_c, ∂m/∂p₁ of the fit."""
    return features_motion(memory[0], p1, points, o_c, shaft)


@compiled
def motion_at(memory: Rows[Prospect], p1: Floats, shaft: Shaft) -> Floats:
    """∂m/∂p₁ (4, 3) px/mm of both markers, with marker 1 at p1 (3,) mm."""
    return both_motions(memory[0], p1, shaft)


@compiled
def markers_at(memory: Rows[Prospect], p1: Floats, shaft: Shaft) -> Floats:
    """The markers (2, 2) raw px at p1 (3,) mm, without their noise."""
    return located(memory[0], p1, shaft)


@compiled
def picture_of(memory: Rows[Prospect], p: Floats) -> tuple[Floats, Floats]:
    """Where a point p (3,) mm is seen, (2,) raw px, and the covariance (2, 2) px² of that."""
    return imaged(memory[0], p)


@dataclass(frozen=True)
class DltEstimator(Estimator):
    """Ĵ through the whole projection, fitted to all frames."""

    name = "dlt"
    models = True
    places_rcm = True
    spares_marker = True
    rule = ()

    def init(self) -> Rows[Prospect]:
        return blank().rows

    def update(self, memory: Rows[Prospect], tool: Tool, sample: Sample) -> Rows[Prospect]:
        return update(memory, sample.p1, sample.points, tool.shaft)

    def jacobian(self, memory: Rows[Prospect], tool: Tool, sample: Sample) -> Floats:
        return jacobian_at(memory, sample.p1, sample.points, sample.o_c, tool.shaft)

    def located(self, memory: Rows[Prospect], tool: Tool, sample: Sample) -> Floats:
        return markers_at(memory, sample.p1, tool.shaft)

    def motion(self, memory: Rows[Prospect], tool: Tool, sample: Sample) -> Floats:
        return motion_at(memory, sample.p1, tool.shaft)

    def imaged_rcm(self, memory: Rows[Prospect]) -> tuple[Floats, Floats]:
        return picture_of(memory, RCM)

    def predict(self, memory: Rows[Prospect], tool: Tool, p1: Floats) -> Floats:
        o_c, both = picture_of(memory, RCM)[0], (p1.copy(), tool.second_marker(p1))
        return np.concatenate([picture_of(memory, p)[0] - o_c for p in both])

    def remembered(self, memory: Any) -> Floats:
        known = Prospect(memory)
        numbers = known.A.ravel(), known.g, known.origin, known.offset.ravel(), [known.noise]
        return np.concatenate(numbers)
