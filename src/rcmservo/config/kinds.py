"""What can be chosen by a name: the classes of every box of a servo, as files, records and the
command line call them.

An estimator of somebody else is called module:class, such as ``mylab.rls:RLS``. A file or record
only names it: a table of names holds it once the command line has named it too.
"""

from collections.abc import Mapping
from typing import Any

from rcmservo.config.decode import decode
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
from rcmservo.servo.own_estimator import called

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


def chosen(kinds: Kinds, table: object, where: str) -> Any:
    """The settings of the class that the table's `kind` names."""
    if not is_table(table):
        raise BadInput(where, table, "a table of settings")
    rest = dict(table)
    kind = kind_in(kinds, rest.pop("kind", None), where)
    return decode(kind, rest, where)


def kind_in(kinds: Kinds, name: object, where: str) -> type[Any]:
    """The class of a name; whoever names another one is told those that there are."""
    if isinstance(name, str) and name in kinds:
        return kinds[name]
    foreign = isinstance(name, str) and ":" in name and "estimator" in where
    only = "; code of others is run only where the command line names it" if foreign else ""
    raise BadInput(f"{where}.kind", name, f"one of {', '.join(kinds)}{only}")
