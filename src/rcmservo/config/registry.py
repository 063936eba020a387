"""Registry of the parts of a servo and of their classes, by the names that files, records, options,
studies and the page use.

The fields of `Servo` are its parts. A part whose type is abstract has the classes of `REGISTERED`
that derive from it; every other part has the class of its type. A class is called by its ``name``,
and the fields of the dataclass are its settings: no other place lists parts, classes or settings.

A user's own estimator is called module:class, such as ``mylab.rls:RLS``. A file or record only
names it: a table of classes holds it once the command line has named it too.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, get_type_hints

from rcmservo.config.strict_decoding import decode, instead, key_of
from rcmservo.config.texts import is_table
from rcmservo.errors import BadInput
from rcmservo.estimation.affine import AffineEstimator
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.broyden import BroydenEstimator
from rcmservo.estimation.correntropy import CorrentropyEstimator
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.kalman import KalmanEstimator
from rcmservo.estimation.normalised_flow import NormalisedFlowEstimator
from rcmservo.estimation.projection_rule import PRINTED, ProjectionEstimator
from rcmservo.estimation.rls import RlsEstimator
from rcmservo.geometry.kinematics import PitchYawRcm, SphericalRcm
from rcmservo.geometry.tool import RigidTool, ScaledTool
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import called

Classes = Mapping[str, type[Any]]
"""Classes by their names."""

__all__ = [  # noqa: RUF022  (the order of lists for users)
    "SphericalRcm",
    "PitchYawRcm",
    "RigidTool",
    "ScaledTool",
    "ProjectionEstimator",
    "DltEstimator",
    "AffineEstimator",
    "FlowEstimator",
    "BroydenEstimator",
    "NormalisedFlowEstimator",
    "RlsEstimator",
    "KalmanEstimator",
    "CorrentropyEstimator",
]
"""Classes that can be chosen for a part, one a line; `rcmservo` offers them as they are."""
REGISTERED: tuple[type[Any], ...] = tuple(globals()[name] for name in __all__)


def _classes(base: type[Any]) -> Classes:
    """Return the classes of a part by their names."""
    return {kind.name: kind for kind in REGISTERED if issubclass(kind, base)} or {base.name: base}


_TYPES = get_type_hints(Servo)
PARTS: Mapping[str, Classes] = {
    f.name: _classes(_TYPES[f.name]) for f in fields(Servo) if _TYPES[f.name] is not float
}
"""The parts of a servo, and their classes. (`Servo.rate` is a number, not a part.)"""
MECHANISMS, TOOLS, ESTIMATORS = (PARTS[part] for part in ("mechanism", "tool", "estimator"))
PRESETS: Mapping[str, Estimator] = {"projection-printed": PRINTED}
"""Estimators with settings of their own that the command line has a name for."""

KIND = "kind"
"""The key that names a table's class."""


def name_of(value: object, classes: Classes) -> str:
    """Return the name of the class of a value among `classes`, or module:class."""
    names = (name for name, kind in classes.items() if kind is type(value))
    return next(names, called(value))


def decode_kind(classes: Classes, table: object, where: str, default: object = None) -> Any:
    """Return the settings of the class that the table's `kind` names.

    Without `kind` that is the only class, or the class of ``default``, whose values stand for those
    that a table of its class leaves out.
    """
    if not is_table(table):
        raise BadInput(where, table, "a table of settings")
    rest = dict(table)
    if default is None and KIND not in rest:
        _require_known(classes, rest, where)
    usual = next(iter(classes)) if len(classes) == 1 else None
    usual = usual if default is None else name_of(default, classes)
    kind = find_class(classes, rest.pop(KIND, usual), where)
    if is_dataclass(default) and type(default) is kind:
        rest = {**vars(default), **rest}
    return decode(kind, rest, where, others=(KIND,) if len(classes) > 1 else ())


def _require_known(classes: Classes, table: Mapping[str, object], where: str) -> None:
    """Refuse a key that no class has: a misspelt `kind` is one."""
    names = [KIND, *dict.fromkeys(f.name for kind in classes.values() for f in fields(kind))]
    for key, value in table.items():
        if key not in names:
            raise BadInput(f"{where}.{key_of(key)}", value, instead(key, names))


def find_class(classes: Classes, name: object, where: str) -> type[Any]:
    """Return the class of a name; BadInput, with the known names, for another one."""
    if isinstance(name, str) and name in classes:
        return classes[name]
    foreign = isinstance(name, str) and ":" in name and "estimator" in where
    only = "; code of others is run only where the command line names it" if foreign else ""
    raise BadInput(f"{where}.kind", name, f"one of {', '.join(classes)}{only}")
