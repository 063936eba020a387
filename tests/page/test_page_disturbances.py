"""Disturbances from the page's menu; none of them enables the drive.

test_page.py tests the fault and the recovery from it.
"""

from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from rcmservo.errors import BadInput
from rcmservo.live.arm_datagrams import arm_socket_path, open_socket
from rcmservo.sim import Rig
from rcmservo.sim.processes.arm_process import ArmDevice
from rcmservo.sim.processes.live_disturbances import (
    DisturbanceChange,
    list_live_disturbances,
    parse_live_disturbance,
)
from rcmservo.sim.processes.motion_log import MotionLog

MS = 1_000_000


@pytest.mark.parametrize("kind", [one["kind"] for one in list_live_disturbances()])
def test_each_kind_on_the_menu_is_valid_with_its_defaults(kind: str) -> None:
    assert parse_live_disturbance(f"{kind}:").kind == kind


@pytest.mark.parametrize(
    "text", ["kill:", "nan_points:", "flood:", "occlusion:for=-1", "occlusion:px=3", "smoke:"]
)
def test_kinds_and_parameters_that_the_menu_lacks_are_refused(text: str) -> None:
    with pytest.raises(BadInput):
        parse_live_disturbance(text)


@pytest.fixture
def device(tmp_path: Path) -> Iterator[ArmDevice]:
    with open_socket(arm_socket_path(tmp_path)) as websocket:
        yield ArmDevice(Rig(1, pictures=False), websocket, MotionLog(get_context("spawn")), 0)


def test_an_emergency_stop_prevents_enable_and_its_release_enables_nothing(
    device: ArmDevice,
) -> None:
    device.disturbed_arm.enable()
    device.step(device.arm.time + MS)
    assert device.arm.watchdog.enabled
    schedule = device.rig.schedule
    DisturbanceChange(device.arm.time, parse_live_disturbance("drive_off:")).apply(schedule)
    device.step(device.arm.time + 2 * MS)
    device.disturbed_arm.enable()
    assert not device.arm.watchdog.enabled
    DisturbanceChange(device.arm.time, None).apply(schedule)
    device.step(device.arm.time + 20 * MS)
    assert not device.arm.watchdog.enabled
    device.disturbed_arm.enable()
    assert device.arm.watchdog.enabled


def test_a_creep_acts_from_its_beginning_to_its_end(device: ArmDevice) -> None:
    device.disturbed_arm.enable()
    q = device.arm.q_true.copy()
    DisturbanceChange(device.arm.time, parse_live_disturbance("creep:speed=20,axis=3")).apply(
        device.rig.schedule
    )
    device.step(device.arm.time + 20 * MS)
    assert abs(device.arm.q_true[2] - q[2]) > 0.1
    DisturbanceChange(device.arm.time, None).apply(device.rig.schedule)
    device.step(device.arm.time + 20 * MS)
    q = device.arm.q_true.copy()
    device.step(device.arm.time + 20 * MS)
    assert np.allclose(device.arm.q_true, q, atol=1e-3)
