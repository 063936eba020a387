"""Options for the estimator and the settings of the method, shared by the commands that servo.

The settings classes in the registry (config/class_registry.py) become groups of options, such as
--controller.gain; a field of a settings class is an option without further code. A user-defined
estimator that the command line names adds a group with its own settings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, ClassVar, TypeVar

import tyro

from rcmservo.config.class_registry import ESTIMATORS, PART_CLASSES, PRESETS, Classes
from rcmservo.config.rig_file import METHOD_PARTS, RigDescription
from rcmservo.config.user_estimators import ESTIMATOR_OPTION, import_estimator
from rcmservo.constraints import Checked
from rcmservo.errors import BadInput, suggest_name
from rcmservo.estimation.base import Estimator
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import check_estimator, format_class_name

Options = TypeVar("Options")

ESTIMATOR_NAMES = (*ESTIMATORS, *PRESETS)
ESTIMATOR_ARGUMENT = tyro.conf.arg(metavar="NAME")
EstimatorName = Annotated[str, ESTIMATOR_ARGUMENT]
"""Name of a built-in estimator, or a user-defined one as module:class."""
OptionalEstimator = Annotated[str | None, ESTIMATOR_ARGUMENT]

OPTION_GROUPS: Classes = {
    part if len(PART_CLASSES[part]) == 1 else class_name: settings_class
    for part in sorted(METHOD_PARTS, key=lambda part: len(PART_CLASSES[part]))
    for class_name, settings_class in PART_CLASSES[part].items()
}
"""Classes whose settings are options, by the prefix of these options.

The prefix is the name of the part, or that of the class if the part has several classes.
"""


@dataclass(frozen=True)
class EstimatorOptions(Checked):
    """Options of a command that accepts a user-defined estimator."""

    USER_GROUPS: ClassVar[Mapping[str, str]] = {}
    """Option groups of the user-defined estimators, by the names of the estimators."""

    @property
    def user_estimators(self) -> dict[str, Estimator]:
        """User-defined estimators by the names that the command line gives them."""
        return {name: getattr(self, group) for name, group in self.USER_GROUPS.items()}


def _add_option_groups(
    command: type[Options], groups: Classes, **attributes: object
) -> type[Options]:
    """Return a command's options with one group of options for each class of settings."""
    namespace = {"__doc__": command.__doc__, "__module__": command.__module__, **attributes}
    new_fields = [(name, cls, field(default_factory=cls)) for name, cls in groups.items()]
    return make_dataclass(
        command.__name__,
        new_fields,
        bases=(command,),
        namespace=namespace,
        frozen=True,
        kw_only=True,
    )


def _add_part_groups(command: type[Options]) -> type[Options]:
    """Return a command's options with the groups of the method's parts."""
    return _add_option_groups(command, OPTION_GROUPS)


@_add_part_groups
class ServoOptions(EstimatorOptions):
    """Options of a command that makes a servo: the settings of the method's parts."""

    @property
    def estimators(self) -> dict[str, Estimator]:
        """Estimators by the names that the command line and the results use."""
        built_in = {name: getattr(self, name) for name in ESTIMATORS}
        return {**built_in, **self.user_estimators, **PRESETS}

    def find_estimator(self, name: str) -> Estimator:
        """Return the estimator of a name.

        Raises
        ------
        BadInput
            If no estimator has this name.
        """
        if name in self.estimators:
            return self.estimators[name]
        names, hint = ", ".join(ESTIMATOR_NAMES), suggest_name(name, self.estimators)
        expected = f"one of {names}, or module:class such as mylab.rls:RLS{hint}"
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

        A user-defined estimator is tried on synthetic samples first.

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
            is_option = error.field.partition(".")[0] in OPTION_GROUPS
            name = f"--{error.field}".replace("_", "-") if is_option else error.field
            raise BadInput(name, error.value, error.expected) from error


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
def _add_user_group(command: type[Any], name: str, estimator_class: type[Estimator]) -> type[Any]:
    """Return the options of a command with the settings of an estimator.

    Equal arguments give the same class, so that options that are parsed twice are comparable.
    """
    group = find_option_group(estimator_class, command)
    user_groups = dict.fromkeys((name, format_class_name(estimator_class)), group)
    return _add_option_groups(command, {group: estimator_class}, USER_GROUPS=user_groups)


def find_option_group(settings_class: type[Any], command: type[Any]) -> str:
    """Return the prefix of the options of a settings class.

    A user-defined estimator whose name is already an option of the command uses the name of its
    module or class instead.
    """
    for group, group_class in OPTION_GROUPS.items():
        if group_class is settings_class:
            return group
    module = settings_class.__module__.rpartition(".")[2]
    candidates = getattr(settings_class, "name", ""), module, settings_class.__name__.lower(), "own"
    taken = {*dir(command), *(f.name for f in fields(command)), *OPTION_GROUPS}
    return next(name for name in candidates if name.isidentifier() and name not in taken)
