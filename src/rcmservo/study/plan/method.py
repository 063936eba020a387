"""Method of a study: the parts of a servo that no rig file describes."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from rcmservo.config.registry import ESTIMATORS, PART_CLASSES, PRESETS, decode_kind
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


def make_default_method(name: str, own: UserEstimators) -> StudyMethod:
    """Return the method with the default settings of the estimator `name` and all other parts."""
    return make_method(name, estimator=_estimator(name, own, "method"))


def parse_method(name: str, table: Table, own: UserEstimators) -> StudyMethod:
    """Return the method that a table describes.

    The entry `estimator` is a name, or a table with its `kind`. The other entries are tables with
    the settings of other parts.
    """
    where, rest = f"method.{name}", dict(table)
    parts = {"estimator": _estimator(rest.pop("estimator", None), own, f"{where}.estimator")}
    for part, settings in rest.items():
        expected = f"one of {', '.join(METHOD_PARTS)}"
        require(part in METHOD_PARTS, f"{where}.{part}", settings, expected)
        parts[part] = decode_kind(PART_CLASSES[part], settings, f"{where}.{part}")
    return make_method(name, **parts)


def _estimator(given: object, own: UserEstimators, where: str) -> Estimator:
    """Return the estimator that a name or a table describes."""
    known = {**ESTIMATORS, **own}
    if is_table(given):
        return decode_kind(known, given, where)
    if isinstance(given, str) and given in PRESETS:
        return PRESETS[given]
    if not isinstance(given, str) or given not in known:
        names = ", ".join((*ESTIMATORS, *PRESETS))
        expected = f"one of {names}, or module:class that --method or --user-estimator names"
        raise BadInput(where, given, expected)
    return known[given]()


def make_servo(method: StudyMethod, lab: RigDescription) -> Servo:
    """Return the servo of a method in a laboratory; examine a user-defined estimator first."""
    check_estimator(method.estimator, lab.tool)
    return lab.make_servo(**method.parts)
