"""A method of a study: the parts of a servo that no rig file describes."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from rcmservo.config.registry import ESTIMATORS, PARTS, PRESETS, decode_kind
from rcmservo.config.rig_file import METHOD_PARTS, Lab
from rcmservo.config.texts import Table, is_table
from rcmservo.errors import BadInput, require
from rcmservo.estimation.base import Estimator
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import examine
from rcmservo.study.plan.user_module_archive import EMPTY, Parcel, parcel_of

Own = Mapping[str, type[Estimator]]
"""Users' own estimators that the command line has named, by module:class."""


@dataclass(frozen=True)
class StudyMethod:
    """A method that a study tries.

    Parameters
    ----------
    name : str
        In rows and reports.
    parts : Mapping[str, Any]
        Every one of METHOD_PARTS.
    """

    name: str
    parts: Mapping[str, Any]

    @property
    def estimator(self) -> Estimator:
        """The estimator of Ĵ."""
        return self.parts["estimator"]

    @cached_property
    def parcel(self) -> Parcel:
        """The user's own module that its estimator is of; empty for ours."""
        kind = type(self.estimator)
        return EMPTY if kind.__module__.startswith("rcmservo.") else parcel_of(kind)


def method_of(name: str, **parts: Any) -> StudyMethod:
    """Return the method with these parts; those left out are the servo's default ones."""
    servo = Lab().servo(**parts)
    return StudyMethod(name, {part: getattr(servo, part) for part in METHOD_PARTS})


def named(name: str, own: Own) -> StudyMethod:
    """Return the method with the built-in settings of an estimator, and those of all other
    parts.
    """
    return method_of(name, estimator=_estimator(name, own, "method"))


def method_from(name: str, table: Table, own: Own) -> StudyMethod:
    """Return the method in a table: `estimator`, by its name or as a table with its `kind`, and
    tables of the other parts' settings.
    """
    where, rest = f"method.{name}", dict(table)
    parts = {"estimator": _estimator(rest.pop("estimator", None), own, f"{where}.estimator")}
    for part, settings in rest.items():
        right = f"one of {', '.join(METHOD_PARTS)}"
        require(part in METHOD_PARTS, f"{where}.{part}", settings, right)
        parts[part] = decode_kind(PARTS[part], settings, f"{where}.{part}")
    return method_of(name, **parts)


def _estimator(given: object, own: Own, where: str) -> Estimator:
    """Return the estimator of a name or a table."""
    known = {**ESTIMATORS, **own}
    if is_table(given):
        return decode_kind(known, given, where)
    if isinstance(given, str) and given in PRESETS:
        return PRESETS[given]
    if not isinstance(given, str) or given not in known:
        names = ", ".join((*ESTIMATORS, *PRESETS))
        right = f"one of {names}, or module:class that --method or --own names"
        raise BadInput(where, given, right)
    return known[given]()


def tried(method: StudyMethod, lab: Lab) -> Servo:
    """Return the servo of a method, whose estimator is tried first if it is a user's own."""
    examine(method.estimator, lab.tool)
    return lab.servo(**method.parts)
