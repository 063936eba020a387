"""A user's own estimator on the command line: its settings become options beside ours."""

from collections.abc import Sequence
from dataclasses import field, fields, make_dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any

import tyro

from rcmservo.app.servo_options import ServoOptions
from rcmservo.config.own_code import OPTION, named
from rcmservo.method.estimators.base import Estimator
from rcmservo.servo.user_estimator import name_of_class


def asked(arguments: Sequence[str]) -> str | None:
    """The estimator that the arguments name, where it is a user's own."""
    words = " ".join(arguments).replace(f"{OPTION}=", f"{OPTION} ").split(" ")
    name = dict(pairwise(words)).get(OPTION, "")
    return name if ":" in name else None


def with_own(command: type[Any], arguments: Sequence[str]) -> type[Any]:
    """Return a command's options with those of the user's own estimator that the arguments name.
    Its code is run here for the first time."""
    name = asked(arguments)
    if name is None or "estimator" not in _names(command):
        return command
    return _extended(command, name, named(name))


@cache
def _extended(command: type[Any], name: str, kind: type[Estimator]) -> type[Any]:
    """Return the options of a command with the estimator's settings, among the servo's boxes if it
    has them. The same arguments give the same class, so that options read twice fit together."""
    names = dict.fromkeys((name, name_of_class(kind)), group_of(kind))
    if "boxes" not in _names(command):
        return _with(command, group_of(kind), kind, OWN=names)
    boxes = _with(ServoOptions, group_of(kind), kind, OWN=names)
    return _with(command, "boxes", boxes, Annotated[boxes, tyro.conf.arg(name="")])


def _with(
    options: type[Any], name: str, kind: type[Any], hint: object = None, **others: object
) -> type[Any]:
    """The options with one field more, which is made of its defaults."""
    told = {"__doc__": options.__doc__, "__module__": options.__module__, **others}
    more = (name, hint or kind, field(default_factory=kind))
    bases = (options,)
    return make_dataclass(options.__name__, [more], bases=bases, frozen=True, namespace=told)


def _names(options: type[Any]) -> set[str]:
    return {f.name for f in fields(options)}


def group_of(kind: type[Estimator]) -> str:
    """What the options of its settings begin with: its name, or else its module's or class's."""
    taken = _names(ServoOptions)
    wanted = (getattr(kind, "name", ""), kind.__module__.rpartition(".")[2], kind.__name__.lower())
    return next(one for one in (*wanted, "own") if one.isidentifier() and one not in taken)
