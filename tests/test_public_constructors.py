"""Constructors of all public classes: an invalid argument is accepted, or refused with its name."""

import inspect
import math
from collections.abc import Iterator
from enum import Enum
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.sim import Rig

ODD_VALUES: dict[str, Any] = {
    "a number": 3,
    "a negative number": -1.5,
    "text": "fast",
    "None": None,
    "a flag": True,
    "a list": [1.0, 2.0],
    "a mapping": {},
    "an array of another shape": np.zeros((5, 5)),
    "an array of text": np.array(["a", "b", "c"]),
    "NaN": math.nan,
    "three NaNs": (math.nan,) * 3,
    "an object": object(),
}
"""Values of many types."""


def required_arguments(name: str) -> dict[str, Any]:
    """Return the arguments that a class requires."""
    if name in ("Plant", "Rig"):
        rig = Rig(seed=0, pictures=False)
        tracker = rs.tracking.PointMarkers()
        devices = {"arm": rig.arm, "camera": rig.camera, "tracker": tracker}
        robot = {"mechanism": rs.SphericalRcm(), "tool": rs.RigidTool(spacing=30.0)}
        return devices | ({"clock": rig.clock} if name == "Plant" else robot)
    q, points = np.zeros(3), np.zeros((2, 2))
    return {
        "Disturbance": {"kind": "freeze"},
        "DriveResponse": {"gain": [None] * 3, "lag_ms": [None] * 3},
        "Frame": {"number": 0, "exposure": 0, "arrival": 0},
        "Jog": {"rates": q},
        "JointLimits": {"lower": (0.0, 0.0, 50.0), "upper": (1.0, 1.0, 90.0)},
        "Markers": {"points": points, "radius": np.ones(2), "quality": np.ones(2)},
        "ArmMeasurement": {"time": 0, "q": q, "enabled": True},
        "RigidTool": {"spacing": 30.0},
        "ScaledTool": {"scale": 1.5},
        "Servo": {"mechanism": rs.SphericalRcm(), "tool": rs.RigidTool(spacing=30.0)},
        "SimulatedRig": {"pictures": False},
        "Target": {"points": points, "q": q},
    }.get(name, {})


PER_TICK = "Command", "MarkerPair", "Observation", "Sample", "State", "Tick"
"""Classes that only the servo and its loop construct, up to a thousand times a second."""

MESSAGE_SPELLINGS = {"duration": "for"}
"""Arguments for which a message uses the spelling of a disturbance."""


def list_public_classes() -> Iterator[tuple[str, type[Any]]]:
    """Yield names and classes that a user constructs."""
    for module in (rs, rs.sim, rs.tracking):
        for name in module.__all__:
            made = getattr(module, name)
            is_plain = inspect.isclass(made) and not issubclass(made, Enum | BaseException)
            is_abstract = inspect.isabstract(made) or getattr(made, "_is_protocol", False)
            if is_plain and not is_abstract and name not in PER_TICK:
                yield name, made


ARGUMENTS = [
    pytest.param(made, argument, id=f"{name}-{argument}")
    for name, made in list_public_classes()
    for argument in inspect.signature(made).parameters
]


@pytest.mark.parametrize(("made", "argument"), ARGUMENTS)
def test_an_invalid_argument_is_refused_with_field_value_and_expected_value(
    made: type[Any], argument: str
) -> None:
    required = required_arguments(made.__name__)
    for kind, value in ODD_VALUES.items():
        try:
            made(**required | {argument: value})
        except rs.BadInput as refused:
            assert refused.expected, kind
            spelling = MESSAGE_SPELLINGS.get(argument, argument)
            assert spelling in refused.field or refused.field == made.__name__.lower(), kind
        except Exception as error:
            pytest.fail(f"{kind}: {error!r}")
