"""What can be chosen by a name: the classes of every box of a servo, as files, records and the
command line call them.

An estimator of somebody else is called module:class, such as ``mylab.rls:RLS``. A file or record
only names it: a table of names holds it once the command line has named it too.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from rcmservo.config.decode import decode, instead, key_of
from rcmservo.config.texts import is_table
from rcmservo.errors import BadInput
from rcmservo.guard.gate import Gate
from rcmservo.guard.thresholds import Thresholds
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.affine import AffineEstimator
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.correntropy import CorrentropyEstimator
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.flow import FlowEstimator
from rcmservo.method.estimators.kalman import KalmanEstimator
from rcmservo.method.estimators.nflow import NormalisedFlowEstimator
from rcmservo.method.estimators.projection import PRINTED, ProjectionEstimator
from rcmservo.method.estimators.rls import RlsEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.method.kinematics import Kinematics, PitchYawRcm, SphericalRcm
from rcmservo.method.tool import RigidTool, ScaledTool, Tool
from rcmservo.servo.user_estimator import called

MECHANISMS: Mapping[str, type[Kinematics]] = {
    kind.name: kind for kind in (SphericalRcm, PitchYawRcm)
}
TOOLS: Mapping[str, type[Tool]] = {kind.name: kind for kind in (RigidTool, ScaledTool)}
ESTIMATORS: Mapping[str, type[Estimator]] = {
    kind.name: kind
    for kind in (
        ProjectionEstimator,
        DltEstimator,
        AffineEstimator,
        FlowEstimator,
        BroydenEstimator,
        NormalisedFlowEstimator,
        RlsEstimator,
        KalmanEstimator,
        CorrentropyEstimator,
    )
}
PRESETS: Mapping[str, Estimator] = {"projection-printed": PRINTED}
"""Estimators with settings of their own that the command line has a name for."""

KIND = "kind"
"""The key that names a table's class."""
Kinds = Mapping[str, type[Any]]
KINDS: Mapping[str, Kinds] = {
    "mechanism": MECHANISMS,
    "tool": TOOLS,
    "estimator": ESTIMATORS,
    "controller": {"saturated": SaturatedController},
    "exploration": {"tour": Exploration},
    "imaged_rcm": {"lines": ImagedRcm},
    "gate": {"gate": Gate},
    "thresholds": {"thresholds": Thresholds},
}
"""Every box of a servo, and its classes by name."""


def name_of(value: object, kinds: Kinds) -> str:
    """What the class of a value is called: its name among `kinds`, or module:class."""
    ours = (name for name, kind in kinds.items() if kind is type(value))
    return next(ours, called(value))


def chosen(kinds: Kinds, table: object, where: str, default: object = None) -> Any:
    """The settings of the class that the table's `kind` names.

    Without `kind` that is the class of ``default``, whose values stand for those that a table of
    its class leaves out.
    """
    if not is_table(table):
        raise BadInput(where, table, "a table of settings")
    rest = dict(table)
    if default is None and KIND not in rest:
        _require_known(kinds, rest, where)
    usual = None if default is None else name_of(default, kinds)
    kind = kind_in(kinds, rest.pop(KIND, usual), where)
    if is_dataclass(default) and type(default) is kind:
        rest = {**vars(default), **rest}
    return decode(kind, rest, where, others=(KIND,))


def _require_known(kinds: Kinds, table: Mapping[str, object], where: str) -> None:
    """Refuse a key that no kind has: a misspelt `kind` is one."""
    names = [KIND, *dict.fromkeys(f.name for kind in kinds.values() for f in fields(kind))]
    for key, value in table.items():
        if key not in names:
            raise BadInput(f"{where}.{key_of(key)}", value, instead(key, names))


def kind_in(kinds: Kinds, name: object, where: str) -> type[Any]:
    """The class of a name; whoever names another one is told those that there are."""
    if isinstance(name, str) and name in kinds:
        return kinds[name]
    foreign = isinstance(name, str) and ":" in name and "estimator" in where
    only = "; code of others is run only where the command line names it" if foreign else ""
    raise BadInput(f"{where}.kind", name, f"one of {', '.join(kinds)}{only}")
