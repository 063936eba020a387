"""A method of a study: an estimator, and the boxes of a servo that go with it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

from rcmservo.config.kinds import ESTIMATORS, KINDS, PRESETS, chosen, kind_in
from rcmservo.config.rig_file import Lab
from rcmservo.config.texts import Table, is_table
from rcmservo.errors import BadInput, require
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import examine
from rcmservo.study.plan.parcel import EMPTY, Parcel, parcel_of

Own = Mapping[str, type[Estimator]]
"""Users' own estimators that the command line has named, by module:class."""

BOXES = "controller", "exploration", "imaged_rcm"
"""Of a method's table, beside its estimator."""


@dataclass(frozen=True)
class StudyMethod:
    """What is tried."""

    name: str
    """In rows and reports."""
    estimator: Estimator
    """How Ĵ is learnt."""
    controller: SaturatedController = field(default_factory=SaturatedController)
    """The law."""
    exploration: Exploration = field(default_factory=Exploration)
    """The first motion."""
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    """How the imaged RCM is computed."""

    @cached_property
    def parcel(self) -> Parcel:
        """The user's own module that its estimator is of; empty for ours."""
        kind = type(self.estimator)
        return EMPTY if kind.__module__.startswith("rcmservo.") else parcel_of(kind)

    def servo(self, lab: Lab) -> Servo:
        """The servo of this method in a laboratory."""
        boxes = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "name"}
        return Servo(lab.mechanism, lab.tool, gate=lab.gate, thresholds=lab.thresholds, **boxes)


def named(name: str, own: Own) -> StudyMethod:
    """The method with the built-in settings of an estimator, and those of all other boxes."""
    return StudyMethod(name, _estimator(name, own, "method"))


def method_from(name: str, table: Table, own: Own) -> StudyMethod:
    """The method in a table: `estimator`, by its name or as a table with its `kind`, and tables of
    the other boxes' settings."""
    where, rest = f"method.{name}", dict(table)
    estimator = _estimator(rest.pop("estimator", None), own, f"{where}.estimator")
    boxes: dict[str, Any] = {}
    for box, settings in rest.items():
        require(box in BOXES, f"{where}.{box}", settings, f"one of estimator, {', '.join(BOXES)}")
        kind = {"kind": next(iter(KINDS[box]))}
        whole = kind | settings if is_table(settings) else settings
        boxes[box] = chosen(KINDS[box], whole, f"{where}.{box}")
    return StudyMethod(name, estimator, **boxes)


def _estimator(told: object, own: Own, where: str) -> Estimator:
    """The estimator of a name or a table."""
    if is_table(told):
        return chosen({**ESTIMATORS, **own}, told, where)
    if isinstance(told, str) and told in PRESETS:
        return PRESETS[told]
    if not isinstance(told, str) or told not in {**ESTIMATORS, **own}:
        names = ", ".join((*ESTIMATORS, *PRESETS))
        right = f"one of {names}, or module:class that --method or --own names"
        raise BadInput(where, told, right)
    return kind_in({**ESTIMATORS, **own}, told, where)()


def tried(method: StudyMethod, lab: Lab) -> Servo:
    """The servo of a method, whose estimator is tried first if it is a user's own."""
    examine(method.estimator, lab.tool)
    return method.servo(lab)
