"""Registry of estimators, mechanisms and tools: the classes of a servo's parts, by name.

To add a class, import it here and add its name to `__all__`. Rig files, records, studies, the page
and the choices of the command line then offer it. Options of one command, such as `rcmservo run`,
are not listed here: they are the fields of its dataclass in cli/, for example in run_options.py.

The fields of `Servo` are its parts. A part with an abstract type, such as `Estimator`, has the
registered classes that derive from this type; every other part has the class of its type. The name
of a class is its attribute ``name``, and the fields of the dataclass are its settings.

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
from rcmservo.servo.user_estimator import format_class_name_of

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


def _select_classes(part_type: type[Any]) -> Classes:
    """Return the classes of a part by their names."""
    derived = {c.name: c for c in REGISTERED_CLASSES if issubclass(c, part_type)}
    return derived or {part_type.name: part_type}


_PART_TYPES = get_type_hints(Servo)
PART_CLASSES: Mapping[str, Classes] = {
    f.name: _select_classes(_PART_TYPES[f.name])
    for f in fields(Servo)
    if _PART_TYPES[f.name] is not float
}
"""Parts of a servo and their classes. (`Servo.rate` is a number, not a part.)"""
MECHANISMS, TOOLS, ESTIMATORS = (PART_CLASSES[part] for part in ("mechanism", "tool", "estimator"))
PRESETS: Mapping[str, Estimator] = {"projection-printed": PAPER_PROJECTION_ESTIMATOR}
"""Estimators of a registered class with special settings, by their names on the command line."""

KIND_KEY = "kind"
"""Key of a table that contains the name of its class."""


def find_class_name(settings: object, classes: Classes) -> str:
    """Return the name of a value's class in `classes`, or module:class for another class."""
    names = (name for name, registered in classes.items() if registered is type(settings))
    return next(names, format_class_name_of(settings))


def decode_kind(classes: Classes, table: object, path: str, default: object = None) -> Any:
    """Return the settings in a table, as an instance of the class that its key `kind` names.

    Parameters
    ----------
    classes : Classes
        Permitted classes by name.
    table : object
        Table of settings.
    path : str
        Path of the table in its file, such as servo.estimator, for error messages.
    default : object
        Settings that replace what the table omits: the class if the key `kind` is missing, and the
        values if the class is the same. None if the table must give all of them.

    Returns
    -------
    object
        Settings, an instance of one of the classes.

    Raises
    ------
    BadInput
        If the table names no permitted class, or has an unknown key or an invalid value.
    """
    if not is_table(table):
        raise BadInput(path, table, "a table of settings")
    values = dict(table)
    if default is None and KIND_KEY not in values:
        _require_known_keys(classes, values, path)
    only_name = next(iter(classes)) if len(classes) == 1 else None
    default_name = only_name if default is None else find_class_name(default, classes)
    settings_class = find_class(classes, values.pop(KIND_KEY, default_name), path)
    if is_dataclass(default) and type(default) is settings_class:
        values = {**vars(default), **values}
    other_keys = () if only_name else (KIND_KEY,)
    return decode_settings(settings_class, values, path, other_keys)


def _require_known_keys(classes: Classes, table: Mapping[str, object], path: str) -> None:
    """Raise `BadInput` for a key that no class has, such as a misspelt `kind`."""
    settings = dict.fromkeys(f.name for c in classes.values() for f in fields(c))
    for key, value in table.items():
        if key not in (KIND_KEY, *settings):
            expected = expect_one_of(key, [KIND_KEY, *settings])
            raise BadInput(f"{path}.{quote_key(key)}", value, expected)


def find_class(classes: Classes, name: object, path: str) -> type[Any]:
    """Return the class of a name.

    Raises
    ------
    BadInput
        If no class has this name; the error lists the known names. ``path`` is the path of the
        table in its file.
    """
    if isinstance(name, str) and name in classes:
        return classes[name]
    is_user_code = isinstance(name, str) and ":" in name and "estimator" in path
    hint = "; user-defined code runs only if the command line names it" if is_user_code else ""
    raise BadInput(f"{path}.kind", name, f"one of {', '.join(classes)}{hint}")
