"""Trouble from the page's menu, and that what is pressed enables nothing. test_page.py goes on to
the fault and its way out."""

from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from rcmservo.errors import BadInput
from rcmservo.live.arm_datagrams import arm_socket_path, open_socket
from rcmservo.sim.processes.arm_process import ArmDevice
from rcmservo.sim.processes.live_disturbances import Mischief, chosen, menu
from rcmservo.sim.processes.motion_log import MotionLog
from rcmservo.sim.rig import Rig

MS = 1_000_000


@pytest.mark.parametrize("kind", [one["kind"] for one in menu()])
def test_each_kind_on_the_menu_can_be_chosen_with_its_defaults(kind: str) -> None:
    assert chosen(f"{kind}:").kind == kind


@pytest.mark.parametrize(
    "text", ["kill:", "nan_points:", "flood:", "occlusion:for=-1", "occlusion:px=3", "smoke:"]
)
def test_what_is_not_on_the_menu_is_refused(text: str) -> None:
    with pytest.raises(BadInput):
        chosen(text)


@pytest.fixture
def device(tmp_path: Path) -> Iterator[ArmDevice]:
    with open_socket(arm_socket_path(tmp_path)) as wire:
        yield ArmDevice(Rig(1, pictures=False), wire, MotionLog(get_context("spawn")), 0)


def test_a_pressed_emergency_stop_lets_nobody_enable_and_its_release_enables_nothing(
    device: ArmDevice,
) -> None:
    device.front.enable()
    device.turn(device.arm.time + MS)
    assert device.arm.watchdog.enabled
    schedule = device.rig.schedule
    Mischief(device.arm.time, chosen("drive_off:")).befalls(schedule)
    device.turn(device.arm.time + 2 * MS)
    device.front.enable()
    assert not device.arm.watchdog.enabled
    Mischief(device.arm.time, None).befalls(schedule)
    device.turn(device.arm.time + 20 * MS)
    assert not device.arm.watchdog.enabled
    device.front.enable()
    assert device.arm.watchdog.enabled


def test_an_arm_that_creeps_creeps_from_then_until_it_is_ended(device: ArmDevice) -> None:
    device.front.enable()
    q = device.arm.q_true.copy()
    Mischief(device.arm.time, chosen("creep:speed=20,axis=3")).befalls(device.rig.schedule)
    device.turn(device.arm.time + 20 * MS)
    assert abs(device.arm.q_true[2] - q[2]) > 0.1
    Mischief(device.arm.time, None).befalls(device.rig.schedule)
    device.turn(device.arm.time + 20 * MS)
    q = device.arm.q_true.copy()
    device.turn(device.arm.time + 20 * MS)
    assert np.allclose(device.arm.q_true, q, atol=1e-3)
