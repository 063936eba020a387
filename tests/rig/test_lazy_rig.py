"""A rig that connects its devices in the process that uses them."""

import pickle
from functools import partial
from typing import Any

import pytest

import rcmservo as rs
from rcmservo.live.device_protocols import NotReady
from rcmservo.rig.lazy_rig import LazyRig

EVENTS: list[str] = []
"""Devices that were connected and closed, in this order."""


class Device:
    """Arm, camera and tracker that only open and close."""

    def __init__(self, name: str) -> None:
        self.name = name
        EVENTS.append(name)

    def close(self) -> None:
        EVENTS.append(f"close {self.name}")


def fail(name: str) -> Any:
    raise rs.RcmServoError(f"no {name}")


def make_rig(missing: str = "") -> LazyRig:
    EVENTS.clear()
    makers: list[Any] = [
        partial(fail if name == missing else Device, name) for name in ("arm", "camera", "tracker")
    ]
    return LazyRig(*makers, rs.SphericalRcm(), rs.RigidTool(30.0))


def test_the_devices_are_connected_in_the_process_that_receives_the_rig() -> None:
    rig = pickle.loads(pickle.dumps(make_rig()))
    assert not EVENTS
    with rig.connected():
        assert rig.arm.name == "arm" and rig.camera.name == "camera"
    assert EVENTS == ["tracker", "arm", "camera", "close camera", "close arm", "close tracker"]
    with pytest.raises(NotReady, match="the rig is not open"):
        rig.arm.measure()


@pytest.mark.parametrize(
    ("missing", "events"),
    [
        ("tracker", []),
        ("arm", ["tracker", "close tracker"]),
        ("camera", ["tracker", "arm", "close arm", "close tracker"]),
    ],
)
def test_a_missing_device_closes_those_before_it(missing: str, events: list[str]) -> None:
    rig = make_rig(missing)
    with pytest.raises(rs.RcmServoError, match=f"no {missing}"), rig.connected():
        pytest.fail("a device is missing")
    assert events == EVENTS
    with pytest.raises(NotReady, match="the rig is not open"):
        rig.arm.measure()
