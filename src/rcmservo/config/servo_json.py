"""A servo in plain words and numbers, and the servo that they describe: what a record needs to be
run again.

    {"mechanism": {"kind": "spherical", "limits": {…}, …}, "tool": {"kind": "rigid", …}, …, "rate":
    100.0}

Numbers come back bit for bit. A box that is not one of ours, such as an estimator that somebody has
made, is told by its class's name only and cannot be rebuilt.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, cast

from rcmservo.config.rig_file import MECHANISMS, TOOLS, build
from rcmservo.errors import BadInput, require
from rcmservo.guard.gate import Gate
from rcmservo.guard.thresholds import Thresholds
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.broyden import BroydenEstimator
from rcmservo.method.estimators.flow import FlowEstimator
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.method.kinematics import JointLimits
from rcmservo.servo.servo import Servo

KINDS: Mapping[str, Mapping[str, type[Any]]] = {
    "mechanism": MECHANISMS,
    "tool": TOOLS,
    "estimator": {
        "projection": ProjectionEstimator,
        "flow": FlowEstimator,
        "broyden": BroydenEstimator,
    },
    "controller": {"saturated": SaturatedController},
    "exploration": {"tour": Exploration},
    "imaged_rcm": {"lines": ImagedRcm},
    "gate": {"gate": Gate},
    "thresholds": {"thresholds": Thresholds},
}
"""Every box of a servo, and its classes by the name that a description calls them."""


def describe(servo: Servo) -> dict[str, Any]:
    """The servo as it comes back from JSON."""
    boxes = {box: _described(getattr(servo, box), kinds) for box, kinds in KINDS.items()}
    return json.loads(json.dumps({**boxes, "rate": servo.rate}))


def _described(value: Any, kinds: Mapping[str, type[Any]]) -> dict[str, Any]:
    for kind, cls in kinds.items():
        if type(value) is cls:
            return {"kind": kind, **asdict(value)}
    return {"kind": f"{type(value).__module__}.{type(value).__qualname__}"}


def rebuild(description: Any) -> Servo:
    """The servo that was described; BadInput, naming the field, where that cannot be."""
    require(isinstance(description, dict), "servo", description, "a table of its settings")
    table = cast(dict[str, Any], description)
    wanted = {*KINDS, "rate"}
    require(set(table) == wanted, "servo", sorted(table), f"a table of {', '.join(sorted(wanted))}")
    rate = table["rate"]
    good = isinstance(rate, int | float) and not isinstance(rate, bool)
    require(good, "servo.rate", rate, "a number of ticks per second")
    boxes = {box: rebuild_box(table, box) for box in KINDS}
    return Servo(**boxes, rate=float(rate))


def rebuild_box(description: Any, box: str) -> Any:
    """One box of the servo that was described, such as its ``mechanism``; BadInput where that
    cannot be."""
    good = isinstance(description, dict) and box in description
    require(good, "servo", cast(Any, description), f"a table with {box}")
    return _rebuilt(description[box], KINDS[box], f"servo.{box}")


def _rebuilt(table: Any, kinds: Mapping[str, type[Any]], where: str) -> Any:
    """One box, with every one of its settings given: a default may change from version to
    version."""
    require(isinstance(table, dict), where, table, "a table of settings")
    rest = dict(cast(dict[str, Any], table))
    kind = rest.pop("kind", None)
    if not isinstance(kind, str) or kind not in kinds:
        raise BadInput(f"{where}.kind", kind, "one of " + ", ".join(kinds))
    names = [f.name for f in fields(kinds[kind])]
    require(
        sorted(rest) == sorted(names), where, sorted(rest), f"a table of kind, {', '.join(names)}"
    )
    if "limits" in rest:
        require(
            isinstance(rest["limits"], dict),
            f"{where}.limits",
            rest["limits"],
            "a table of lower and upper",
        )
        rest["limits"] = build(JointLimits, rest["limits"], f"{where}.limits")
    return build(kinds[kind], rest, where)
