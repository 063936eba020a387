"""Settings of the method's parts as options, derived from the registry.

Each class gives one group of options, the same for every command that makes a servo. A user-defined
estimator adds a group of its own settings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, ClassVar, TypeVar

import tyro

from rcmservo.config.registry import ESTIMATORS, PART_CLASSES, PRESETS, Classes
from rcmservo.config.rig_file import METHOD_PARTS, RigDescription
from rcmservo.config.user_estimators import ESTIMATOR_OPTION, import_estimator
from rcmservo.constraints import Checked
from rcmservo.errors import BadInput, suggestion
from rcmservo.estimation.base import Estimator
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import check_estimator, class_path

Options = TypeVar("Options")

ESTIMATOR_NAMES = (*ESTIMATORS, *PRESETS)
ESTIMATOR_ARGUMENT = tyro.conf.arg(metavar="NAME")
EstimatorName = Annotated[str, ESTIMATOR_ARGUMENT]
"""Name of a built-in estimator, or a user-defined one as module:class."""
OptionalEstimator = Annotated[str | None, ESTIMATOR_ARGUMENT]


OPTION_GROUPS: Classes = {
    part if len(PART_CLASSES[part]) == 1 else name: kind
    for part in sorted(METHOD_PARTS, key=lambda part: len(PART_CLASSES[part]))
    for name, kind in PART_CLASSES[part].items()
}
"""Classes whose settings are options, by the prefix of these options.

The prefix is the name of the part, or that of the class if the part has several classes.
"""


def find_option_group(kind: type[Any], command: type[Any]) -> str:
    """Return the prefix of the options of a class.

    A user-defined estimator whose name is already an option of the command uses the name of its
    module or class instead.
    """
    if kind in OPTION_GROUPS.values():
        return next(group for group, one in OPTION_GROUPS.items() if one is kind)
    candidates = (
        getattr(kind, "name", ""),
        kind.__module__.rpartition(".")[2],
        kind.__name__.lower(),
    )
    taken = {*dir(command), *(f.name for f in fields(command)), *OPTION_GROUPS}
    return next(one for one in (*candidates, "own") if one.isidentifier() and one not in taken)


def _add_option_groups(
    options: type[Options], groups: Classes, **attributes: object
) -> type[Options]:
    """Return a command's options with one group of options for each class."""
    about = {"__doc__": options.__doc__, "__module__": options.__module__, **attributes}
    made = [(name, kind, field(default_factory=kind)) for name, kind in groups.items()]
    return make_dataclass(
        options.__name__, made, bases=(options,), namespace=about, frozen=True, kw_only=True
    )


@dataclass(frozen=True)
class EstimatorOptions(Checked):
    """Options of a command that accepts a user-defined estimator."""

    USER_GROUPS: ClassVar[Mapping[str, str]] = {}
    """Groups of the user-defined estimators, by the names of the estimators."""

    @property
    def user_estimators(self) -> dict[str, Estimator]:
        """User-defined estimators by the names that the command line gives them."""
        return {name: getattr(self, group) for name, group in self.USER_GROUPS.items()}


def _with_part_groups(options: type[Options]) -> type[Options]:
    """Add the groups of the method's parts to a class of options."""
    return _add_option_groups(options, OPTION_GROUPS)


@_with_part_groups
class ServoOptions(EstimatorOptions):
    """Options of a command that makes a servo: the settings of the method's parts."""

    @property
    def estimators(self) -> dict[str, Estimator]:
        """Estimators by the names that the command line and the results use."""
        return (
            {name: getattr(self, name) for name in ESTIMATORS}
            | self.user_estimators
            | dict(PRESETS)
        )

    def find_estimator(self, name: str) -> Estimator:
        """Return the estimator of a name.

        Raises
        ------
        BadInput
            If no estimator has this name.
        """
        if name in self.estimators:
            return self.estimators[name]
        hint = suggestion(name, self.estimators)
        expected = (
            f"one of {', '.join(ESTIMATOR_NAMES)}, or module:class such as mylab.rls:RLS{hint}"
        )
        raise BadInput(ESTIMATOR_OPTION, name, expected)

    @property
    def part_settings(self) -> dict[str, Any]:
        """Settings of the parts that have one class."""
        return {part: getattr(self, part) for part in METHOD_PARTS if part in OPTION_GROUPS}

    def collect_parts(self, estimator: str) -> dict[str, Any]:
        """Return the parts of the method, with the estimator of a name."""
        return {"estimator": self.find_estimator(estimator), **self.part_settings}

    def make_servo(self, estimator: str, lab: RigDescription) -> Servo:
        """Return a servo for a lab, with the estimator of a name.

        A user-defined estimator is tried on made samples first.

        Raises
        ------
        BadInput
            If a setting is refused; the error names the option as typed.
        """
        parts = self.collect_parts(estimator)
        check_estimator(parts["estimator"], lab.tool)
        try:
            return lab.make_servo(**parts)
        except BadInput as error:
            part, _, setting = error.field.partition(".")
            typed = (
                f"--{part}.{setting}".replace("_", "-") if part in OPTION_GROUPS else error.field
            )
            raise BadInput(typed, error.value, error.expected) from error


def add_user_estimator_options(command: type[Options], arguments: Sequence[str]) -> type[Options]:
    """Return a command's options with those of the user-defined estimator that the arguments name.

    This imports the user's code for the first time.
    """
    words = " ".join(arguments).replace(f"{ESTIMATOR_OPTION}=", f"{ESTIMATOR_OPTION} ").split(" ")
    name = dict(pairwise(words)).get(ESTIMATOR_OPTION, "")
    if ":" not in name or not issubclass(command, EstimatorOptions):
        return command
    return _add_user_group(command, name, import_estimator(name))


@cache
def _add_user_group(command: type[Any], name: str, kind: type[Estimator]) -> type[Any]:
    """Return the options of a command with the settings of an estimator.

    Equal arguments give the same class, so that options that are parsed twice are comparable.
    """
    group = find_option_group(kind, command)
    return _add_option_groups(
        command, {group: kind}, USER_GROUPS=dict.fromkeys((name, class_path(kind)), group)
    )
