"""Settings that the page can change, one part of the servo at a time.

A change of the controller takes effect at the next tick, a change of estimator, exploration or
imaged RCM at the next session. Gate, thresholds, mechanism and tool are excluded, so that no
browser changes a safety limit.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.config.class_registry import ESTIMATORS, find_class_name
from rcmservo.config.rig_file import METHOD_PARTS
from rcmservo.config.servo_json import rebuild_part
from rcmservo.errors import require
from rcmservo.page.messages import SettingsChange
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo

IMMEDIATE_PARTS = ("controller",)
"""Parts that may change while the drive is on."""
EDITABLE_PARTS = (*IMMEDIATE_PARTS, *(part for part in METHOD_PARTS if part not in IMMEDIATE_PARTS))
"""Parts that may change at all."""

ServoLimit = Callable[[Servo], Servo]
"""Function that returns a servo with its speed bounded, whatever its settings are."""


def without_limit(servo: Servo) -> Servo:
    """Return the servo unchanged: no limit."""
    return servo


def decode_change(part: object, table: object) -> SettingsChange:
    """Return the change in a browser's message.

    Parameters
    ----------
    part : object
        Name of the part.
    table : object
        All its fields.

    Raises
    ------
    BadInput
        If the part or a field is invalid; the message names the field.
    """
    require(part in EDITABLE_PARTS, "part", part, f"one of {', '.join(EDITABLE_PARTS)}")
    return SettingsChange(str(part), rebuild_part({part: table}, str(part)))


class SelectedSettings:
    """Servo with the settings selected on the page.

    Parameters
    ----------
    servo : Servo
        Servo with the selected settings.
    limit : callable
        Returns the servo that may run with these settings.
    """

    def __init__(self, servo: Servo, limit: ServoLimit = without_limit) -> None:
        self.servo, self._limit = servo, limit

    @property
    def limited(self) -> Servo:
        """Servo that may run: the selection within the limit."""
        return self._limit(self.servo)

    def with_change(self, change: SettingsChange) -> "SelectedSettings":
        """Return the selection with one part changed.

        Raises
        ------
        BadInput
            If the parts do not fit together.
        """
        return SelectedSettings(replace(self.servo, **{change.part: change.value}), self._limit)

    def apply(self, change: SettingsChange) -> None:
        """Change one part of this selection.

        Raises
        ------
        BadInput
            If the parts do not fit together; the selection is then unchanged.
        """
        self.servo = self.with_change(change).servo


def describe_estimator(servo: Servo, has_explored: bool, condition: float, phase: Phase) -> str:
    """Return the state of the estimator in words."""
    name = find_class_name(servo.estimator, ESTIMATORS)
    if phase is Phase.ACQUIRE:
        return f"Estimator {name}: exploring"
    if not has_explored or not np.isfinite(condition):
        return f"Estimator {name}: no estimate yet; Go explores first"
    is_damped = condition > 0.5 * servo.controller.max_condition
    remark = ", so high that the controller is damped" if is_damped else ""
    return f"Estimator {name}: explored, condition of Ĵ {condition:.3g}{remark}"
