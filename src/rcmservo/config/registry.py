"""Registry of the parts of a servo and their classes, by name.

Files, records, options, studies and the page use these names. The fields of `Servo` are its parts.
A part with an abstract type has the classes of `REGISTERED` that derive from it; every other part
has the class of its type. The name of a class is its attribute ``name``, and the fields of the
dataclass are its settings. No other module lists parts, classes or settings.

The name of a user-defined estimator is module:class, such as ``mylab.rls:RLS``. A file or record
may contain this name, but its code is loaded only if the command line names it too.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, get_type_hints

from rcmservo.config.strict_decoding import decode_settings, expect_one_of, quote_key
from rcmservo.config.toml_json_parsing import is_table
from rcmservo.errors import BadInput
from rcmservo.estimation.affine import AffineEstimator
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.broyden import BroydenEstimator
from rcmservo.estimation.correntropy import CorrentropyEstimator
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.kalman import KalmanEstimator
from rcmservo.estimation.normalised_flow import NormalisedFlowEstimator
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR, ProjectionEstimator
from rcmservo.estimation.rls import RlsEstimator
from rcmservo.geometry.kinematics import PitchYawRcm, SphericalRcm
from rcmservo.geometry.tool import RigidTool, ScaledTool
from rcmservo.servo.servo import Servo
from rcmservo.servo.user_estimator import class_path_of

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
"""Classes that can be chosen for a part. The package `rcmservo` exports them."""
REGISTERED_CLASSES: tuple[type[Any], ...] = tuple(globals()[name] for name in __all__)


def _select_classes(base: type[Any]) -> Classes:
    """Return the classes of a part by their names."""
    return {kind.name: kind for kind in REGISTERED_CLASSES if issubclass(kind, base)} or {
        base.name: base
    }


_TYPES = get_type_hints(Servo)
PART_CLASSES: Mapping[str, Classes] = {
    f.name: _select_classes(_TYPES[f.name]) for f in fields(Servo) if _TYPES[f.name] is not float
}
"""Parts of a servo and their classes. (`Servo.rate` is a number, not a part.)"""
MECHANISMS, TOOLS, ESTIMATORS = (PART_CLASSES[part] for part in ("mechanism", "tool", "estimator"))
PRESETS: Mapping[str, Estimator] = {"projection-printed": PAPER_PROJECTION_ESTIMATOR}
"""Estimators with changed settings that have a name on the command line."""

KIND_KEY = "kind"
"""Key of a table that contains the name of its class."""


def find_class_name(settings: object, classes: Classes) -> str:
    """Return the name of a value's class in `classes`, or module:class for another class."""
    names = (name for name, kind in classes.items() if kind is type(settings))
    return next(names, class_path_of(settings))


def decode_kind(classes: Classes, table: object, where: str, default: object = None) -> Any:
    """Return the settings in a table, as an instance of the class that its key `kind` names.

    Parameters
    ----------
    classes : Classes
        Permitted classes by name.
    table : object
        Table of settings.
    where : str
        Path of the table in its file, for error messages.
    default : object
        Settings whose class is taken without the key `kind`, and whose values are taken for keys
        that the table omits; None if the class and all values without a default must be given.

    Raises
    ------
    BadInput
        If the table has an unknown key or an invalid value.
    """
    if not is_table(table):
        raise BadInput(where, table, "a table of settings")
    rest = dict(table)
    if default is None and KIND_KEY not in rest:
        _require_known(classes, rest, where)
    only = next(iter(classes)) if len(classes) == 1 else None
    usual = only if default is None else find_class_name(default, classes)
    kind = find_class(classes, rest.pop(KIND_KEY, usual), where)
    if is_dataclass(default) and type(default) is kind:
        rest = {**vars(default), **rest}
    return decode_settings(kind, rest, where, others=(KIND_KEY,) if len(classes) > 1 else ())


def _require_known(classes: Classes, table: Mapping[str, object], where: str) -> None:
    """Raise `BadInput` for a key that no class has, such as a misspelt `kind`."""
    names = [KIND_KEY, *dict.fromkeys(f.name for kind in classes.values() for f in fields(kind))]
    for key, value in table.items():
        if key not in names:
            raise BadInput(f"{where}.{quote_key(key)}", value, expect_one_of(key, names))


def find_class(classes: Classes, name: object, where: str) -> type[Any]:
    """Return the class of a name; raise `BadInput` with the known names for an unknown one."""
    if isinstance(name, str) and name in classes:
        return classes[name]
    is_user_code = isinstance(name, str) and ":" in name and "estimator" in where
    hint = "; user-defined code runs only if the command line names it" if is_user_code else ""
    raise BadInput(f"{where}.kind", name, f"one of {', '.join(classes)}{hint}")
