"""Client and device over ROS 2 as it is spoken without ROS, in wall time; the client that is killed
in a process of its own."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from crtk_measures import NAME, RunningDevice, client_arm, driven, killed
from test_crtk_command import reached

from rcmservo.hardware.crtk import messages as m
from rcmservo.hardware.crtk.connection import open_transport
from rcmservo.hardware.crtk.settings import RosConnection
from rcmservo.hardware.crtk.transport import NoTransport
from rcmservo.live.lab import NotReady

pytestmark = pytest.mark.alone

DOMAIN = 91
AT_ONCE, STILL_AFTER = -20.0, 100.0
"""ms after its client was killed."""


@pytest.fixture(scope="module")
def device() -> Iterator[RunningDevice]:
    with contextlib.closing(RunningDevice(2, DOMAIN)) as one:
        yield one


@pytest.mark.parametrize("topic", [m.MOTIONS[0], m.MOTIONS[-1]], ids=lambda topic: topic.name)
def test_somebody_else_who_moves_it_is_heard(device: RunningDevice, topic: m.Topic[Any]) -> None:
    """By joints or by the tool's place; a program of ROS's own sends surely."""
    other, sure = (
        open_transport(RosConnection(domain=DOMAIN)),
        replace(topic.under(NAME), lossy=False),
    )
    hearing = 2 if topic.name == "servo_jp" else 1
    with contextlib.closing(other), contextlib.closing(client_arm(2, DOMAIN)) as arm:
        other.offer(sure)
        assert reached(lambda: other.listeners(sure) == hearing)
        arm.enable()
        other.publish(sure, topic.kind(time.time_ns()))
        assert reached(lambda: arm.why_off != "")
        assert "somebody else sends PSM1 where to go" in arm.why_off


def test_every_command_is_accounted_for_and_arrives(device: RunningDevice) -> None:
    before = device.transport.heard.get(f"{NAME}/servo_jp", 0)
    told = driven(2, DOMAIN, 1.0)
    assert told["on"] and told["commands"] > 60
    assert told["sent"] + told["withheld"] + told["refused"] == told["commands"]
    heard = device.transport.heard[f"{NAME}/servo_jp"] - before
    assert heard == told["sent"] > 60 and told["warned"] == 0


def test_it_stands_still_100_ms_after_its_client_was_killed(device: RunningDevice) -> None:
    assert AT_ONCE < killed(2, DOMAIN, device, 0.13) <= STILL_AFTER
    assert device.device.state == "ENABLED"


def test_the_next_client_finds_it_on_and_makes_it_its_own(device: RunningDevice) -> None:
    with contextlib.closing(client_arm(2, DOMAIN)) as arm:
        assert arm.homed()
        arm.enable()
        assert arm.measure().enabled and not arm.why_off
    assert device.device.state == "DISABLED"


def test_who_comes_later_hears_how_it_is(device: RunningDevice) -> None:
    """Maybe more than once, and the last words last."""
    heard: list[m.OperatingState] = []
    with contextlib.closing(client_arm(2, DOMAIN)) as arm:
        arm.enable()
    with contextlib.closing(open_transport(RosConnection(domain=DOMAIN))) as later:
        topic = m.OPERATING_STATE.under(NAME)
        later.subscribe(topic, lambda said, writer: heard.append(said))
        assert reached(lambda: bool(heard) and heard[-1].state == "DISABLED")
    stamps = [said.stamp for said in heard]
    assert stamps == sorted(stamps)


def test_where_nobody_is_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcmservo.hardware.crtk.arm.FOUND_WITHIN", 0.2)
    with pytest.raises(NotReady, match="nobody tells PSM1/measured_js by ROS 2, domain 92 on lo"):
        client_arm(2, 92)


def test_an_interface_that_is_not_there_is_one_sentence() -> None:
    with pytest.raises(NoTransport, match="ROS 2 cannot be spoken on nowhere0, domain 93"):
        open_transport(RosConnection(domain=93, interface="nowhere0"))
