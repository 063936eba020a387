"""Method of a study: the parts of a servo that no rig file describes.

Such parts are the estimator, the controller and the exploration. A rig file describes the
mechanism, the tool and the camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from rcmservo.config.class_registry import ESTIMATORS, PART_CLASSES, PRESETS, decode_kind
from rcmservo.config.rig_file import METHOD_PARTS, RigDescription
from rcmservo.config.toml_json_parsing import Table, is_table
from rcmservo.errors import BadInput, require
from rcmservo.estimation.base import Estimator
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import check_estimator
from rcmservo.study.plan.user_module_archive import NO_ARCHIVE, ModuleArchive, archive_module

UserEstimators = Mapping[str, type[Estimator]]
"""User-defined estimators of the command line, by module:class."""


@dataclass(frozen=True)
class StudyMethod:
    """Method that a study compares with others.

    Parameters
    ----------
    name : str
        Name in rows and reports.
    parts : Mapping[str, Any]
        Settings of every part in METHOD_PARTS.
    """

    name: str
    parts: Mapping[str, Any]

    @property
    def estimator(self) -> Estimator:
        """Estimator of Ĵ."""
        return self.parts["estimator"]

    @cached_property
    def archive(self) -> ModuleArchive:
        """Module of a user-defined estimator; empty for a built-in one."""
        kind = type(self.estimator)
        return NO_ARCHIVE if kind.__module__.startswith("rcmservo.") else archive_module(kind)


def make_method(name: str, **parts: Any) -> StudyMethod:
    """Return the method with these parts, and the servo's defaults for the others."""
    servo = RigDescription().make_servo(**parts)
    return StudyMethod(name, {part: getattr(servo, part) for part in METHOD_PARTS})


def make_default_method(name: str, user_estimators: UserEstimators) -> StudyMethod:
    """Return the method with the default settings of the estimator `name` and all other parts."""
    return make_method(name, estimator=_parse_estimator(name, user_estimators, "method"))


def parse_method(name: str, table: Table, user_estimators: UserEstimators) -> StudyMethod:
    """Return the method that a table describes.

    The entry `estimator` is a name, or a table with its `kind`. The other entries are tables with
    the settings of other parts.
    """
    field, other_parts = f"method.{name}", dict(table)
    estimator = other_parts.pop("estimator", None)
    parts = {"estimator": _parse_estimator(estimator, user_estimators, f"{field}.estimator")}
    for part, settings in other_parts.items():
        expected = f"one of {', '.join(METHOD_PARTS)}"
        require(part in METHOD_PARTS, f"{field}.{part}", settings, expected)
        parts[part] = decode_kind(PART_CLASSES[part], settings, f"{field}.{part}")
    return make_method(name, **parts)


def _parse_estimator(entry: object, user_estimators: UserEstimators, field: str) -> Estimator:
    """Return the estimator that a name or a table describes; error messages name the `field`."""
    kinds = {**ESTIMATORS, **user_estimators}
    if is_table(entry):
        return decode_kind(kinds, entry, field)
    if isinstance(entry, str) and entry in PRESETS:
        return PRESETS[entry]
    if not isinstance(entry, str) or entry not in kinds:
        names = ", ".join((*ESTIMATORS, *PRESETS))
        expected = f"one of {names}, or module:class that --method or --user-estimator names"
        raise BadInput(field, entry, expected)
    return kinds[entry]()


def make_servo(method: StudyMethod, lab: RigDescription) -> Servo:
    """Return the servo of a method in a laboratory; examine a user-defined estimator first."""
    check_estimator(method.estimator, lab.tool)
    return lab.make_servo(**method.parts)
