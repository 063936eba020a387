"""The settings that a person changes on the page: whole boxes of the servo, one at a time.

controller                            holds from the next tick on
estimator, exploration, imaged RCM    hold from the next session on

Gate, thresholds, mechanism and tool are not among them: no browser moves a limit.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.config.registry import ESTIMATORS, name_of
from rcmservo.config.rig_file import METHOD_PARTS
from rcmservo.config.servo_json import rebuild_part
from rcmservo.errors import require
from rcmservo.page.messages import Change
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo

IMMEDIATE_PARTS = ("controller",)
"""Boxes that may change while the drive is on."""
BOXES = (*IMMEDIATE_PARTS, *(part for part in METHOD_PARTS if part not in IMMEDIATE_PARTS))
"""Boxes that may change at all: the parts of the method."""

ServoLimit = Callable[[Servo], Servo]
"""Bounds a servo, whatever was set of it."""


def as_set(servo: Servo) -> Servo:
    """No bound but its own."""
    return servo


def decode_change(part: object, table: object) -> Change:
    """The change that a browser's table for a box asks for, every field given; BadInput, naming the
    field, where there is no such change.
    """
    require(part in BOXES, "box", part, f"one of {', '.join(BOXES)}")
    return Change(str(part), rebuild_part({part: table}, str(part)))


class Chosen:
    """The servo as a person has set it, and the ``limit`` that holds whatever is set."""

    def __init__(self, servo: Servo, limit: ServoLimit = as_set) -> None:
        self.servo, self._limit = servo, limit

    @property
    def limited(self) -> Servo:
        """The servo that may run."""
        return self._limit(self.servo)

    def with_change(self, change: Change) -> "Chosen":
        """What is chosen with one box changed; BadInput where the boxes do not go together."""
        return Chosen(replace(self.servo, **{change.part: change.value}), self._limit)

    def take(self, change: Change) -> None:
        """Change one box from now on; BadInput, and no change, where the boxes do not go
        together.
        """
        self.servo = self.with_change(change).servo


def describe_estimator(servo: Servo, has_explored: bool, condition: float, phase: Phase) -> str:
    """How the estimator stands, in words."""
    name = name_of(servo.estimator, ESTIMATORS)
    if phase is Phase.ACQUIRE:
        return f"Estimator {name}: exploring"
    if not has_explored or not np.isfinite(condition):
        return f"Estimator {name}: knows nothing yet, Go explores first"
    damped = condition > 0.5 * servo.controller.max_condition
    more = ", so high that the law is damped" if damped else ""
    return f"Estimator {name}: explored, condition of Ĵ {condition:.3g}{more}"
