"""Settings of the method's parts as options, derived from the registry: one group of options for
each class, the same for every command that makes a servo.

The settings of a user's own estimator become options beside the built-in ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, ClassVar, TypeVar

import tyro

from rcmservo.config.registry import ESTIMATORS, PARTS, PRESETS, Classes
from rcmservo.config.rig_file import METHOD_PARTS, Lab
from rcmservo.config.user_code import OPTION, named
from rcmservo.constraints import Checked
from rcmservo.errors import BadInput, suggestion
from rcmservo.estimation.base import Estimator
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import examine, name_of_class

Options = TypeVar("Options")

ESTIMATOR_NAMES = (*ESTIMATORS, *PRESETS)
ESTIMATOR_ARGUMENT = tyro.conf.arg(metavar="NAME")
EstimatorName = Annotated[str, ESTIMATOR_ARGUMENT]
"""An estimator by its name, or a user's own by that of its class."""
OptionalEstimator = Annotated[str | None, ESTIMATOR_ARGUMENT]


OPTION_GROUPS: Classes = {
    part if len(PARTS[part]) == 1 else name: kind
    for part in sorted(METHOD_PARTS, key=lambda part: len(PARTS[part]))
    for name, kind in PARTS[part].items()
}
"""Classes whose settings are options, by what these options begin with: the part's name, or the
class's own where the part has several."""


def option_group(kind: type[Any], command: type[Any]) -> str:
    """Return what the options of a class begin with. A user's estimator whose name the command has
    for something else goes by its module or class.
    """
    if kind in OPTION_GROUPS.values():
        return next(group for group, one in OPTION_GROUPS.items() if one is kind)
    wanted = (getattr(kind, "name", ""), kind.__module__.rpartition(".")[2], kind.__name__.lower())
    taken = {*dir(command), *(f.name for f in fields(command)), *OPTION_GROUPS}
    return next(one for one in (*wanted, "own") if one.isidentifier() and one not in taken)


def _with_groups(options: type[Options], groups: Classes, **attributes: object) -> type[Options]:
    """Return a command's options with a group of options for each of these classes."""
    about = {"__doc__": options.__doc__, "__module__": options.__module__, **attributes}
    made = [(name, kind, field(default_factory=kind)) for name, kind in groups.items()]
    return make_dataclass(
        options.__name__, made, bases=(options,), namespace=about, frozen=True, kw_only=True
    )


@dataclass(frozen=True)
class EstimatorOptions(Checked):
    """Options of a command that takes a user's own estimator."""

    USER_GROUPS: ClassVar[Mapping[str, str]] = {}
    """The groups of users' own estimators, by the estimators' names."""

    @property
    def user_estimators(self) -> dict[str, Estimator]:
        """The users' own estimators by the names that the command line gives them."""
        return {name: getattr(self, group) for name, group in self.USER_GROUPS.items()}


def _with_part_groups(options: type[Options]) -> type[Options]:
    """Add GROUPS to a class of options."""
    return _with_groups(options, OPTION_GROUPS)


@_with_part_groups
class ServoOptions(EstimatorOptions):
    """Options of a command that makes a servo: the settings of the method's parts."""

    @property
    def estimators(self) -> dict[str, Estimator]:
        """The estimators by the names that the command line and the results use."""
        return (
            {name: getattr(self, name) for name in ESTIMATORS}
            | self.user_estimators
            | dict(PRESETS)
        )

    def estimator_of(self, name: str) -> Estimator:
        """Return the estimator of this name."""
        if name in self.estimators:
            return self.estimators[name]
        hint = suggestion(name, self.estimators)
        right = f"one of {', '.join(ESTIMATOR_NAMES)}, or module:class such as mylab.rls:RLS{hint}"
        raise BadInput(OPTION, name, right)

    @property
    def settings(self) -> dict[str, Any]:
        """The parts that have one class, as the options set them."""
        return {part: getattr(self, part) for part in METHOD_PARTS if part in OPTION_GROUPS}

    def parts(self, estimator: str) -> dict[str, Any]:
        """Return METHOD_PARTS as the options set them, with the estimator of this name."""
        return {"estimator": self.estimator_of(estimator), **self.settings}

    def servo_of(self, estimator: str, lab: Lab) -> Servo:
        """Return a servo for a laboratory, with the estimator of this name, which is tried if it is
        a user's own.
        """
        parts = self.parts(estimator)
        examine(parts["estimator"], lab.tool)
        try:
            return lab.servo(**parts)
        except BadInput as error:
            part, _, setting = error.field.partition(".")
            typed = (
                f"--{part}.{setting}".replace("_", "-") if part in OPTION_GROUPS else error.field
            )
            raise BadInput(typed, error.value, error.right) from error


def with_own_estimator(command: type[Options], arguments: Sequence[str]) -> type[Options]:
    """Return a command's options with those of the user's own estimator that the arguments name.
    Its code is run here for the first time.
    """
    words = " ".join(arguments).replace(f"{OPTION}=", f"{OPTION} ").split(" ")
    name = dict(pairwise(words)).get(OPTION, "")
    if ":" not in name or not issubclass(command, EstimatorOptions):
        return command
    return _with_user_group(command, name, named(name))


@cache
def _with_user_group(command: type[Any], name: str, kind: type[Estimator]) -> type[Any]:
    """Return the options of a command with the estimator's settings. The same arguments give the
    same class, so that options read twice fit together.
    """
    group = option_group(kind, command)
    return _with_groups(
        command, {group: kind}, USER_GROUPS=dict.fromkeys((name, name_of_class(kind)), group)
    )
