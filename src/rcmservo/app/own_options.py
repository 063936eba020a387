"""A user's own estimator on the command line: its settings become options beside ours."""

from collections.abc import Sequence
from dataclasses import field, fields, make_dataclass
from itertools import pairwise
from typing import Annotated, Any

import tyro

from rcmservo.app.servo_options import ServoOptions
from rcmservo.config.own_code import OPTION, named
from rcmservo.errors import BadInput, RcmServoError, one_line
from rcmservo.method.estimators.base import Estimator
from rcmservo.servo.own_estimator import name_of_class


def asked(arguments: Sequence[str]) -> str | None:
    """The estimator that the arguments name, where it is a user's own."""
    words = " ".join(arguments).replace(f"{OPTION}=", f"{OPTION} ").split(" ")
    name = dict(pairwise(words)).get(OPTION, "")
    return name if ":" in name else None


def with_own(commands: dict[str, type[Any]], arguments: Sequence[str]) -> dict[str, type[Any]]:
    """The commands' options, with those of the user's own estimator that the arguments name. Its
    code is run here for the first time."""
    name = asked(arguments)
    if name is None or arguments[0] not in commands:
        return commands
    command = commands[arguments[0]]
    return commands | {arguments[0]: _extended(command, _boxes(name, named(name)))}


def _extended(command: type[Any], boxes: type[ServoOptions]) -> type[Any]:
    """The options of a command with more boxes, if it has any."""
    if "boxes" not in (f.name for f in fields(command)):
        return command
    more = ("boxes", Annotated[boxes, tyro.conf.arg(name="")], field(default_factory=boxes))
    return make_dataclass(
        command.__name__, [more], bases=(command,), frozen=True, namespace=_told(command)
    )


def _boxes(name: str, kind: type[Estimator]) -> type[ServoOptions]:
    """The boxes with one more, whose settings are the estimator's."""
    _try(name, kind)
    group = _group(kind)
    names = dict.fromkeys((name, name_of_class(kind)), group)
    return make_dataclass(
        "ServoOptions",
        [(group, kind, field(default_factory=kind))],
        bases=(ServoOptions,),
        frozen=True,
        namespace={**_told(ServoOptions), "OWN": names},
    )


def _told(kind: type[Any]) -> dict[str, str | None]:
    return {"__doc__": kind.__doc__, "__module__": kind.__module__}


def _try(name: str, kind: type[Estimator]) -> None:
    """Refuse a class that cannot be made from its defaults."""
    try:
        kind()
    except RcmServoError:
        raise
    except Exception as error:
        right = f"a class whose settings all have a default; to make one raised {one_line(error)}"
        raise BadInput(OPTION, name, right) from error


def _group(kind: type[Estimator]) -> str:
    """What the options of its settings begin with: its name, or else its module's or class's."""
    taken = {f.name for f in fields(ServoOptions)}
    wanted = (getattr(kind, "name", ""), kind.__module__.rpartition(".")[2], kind.__name__.lower())
    return next(one for one in (*wanted, "own") if one.isidentifier() and one not in taken)
