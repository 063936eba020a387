"""Driver and emulated arm over ROS 2 without an installation of ROS, in wall time.

The client that is killed runs in a separate process.
"""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from crtk_measures import NAME, RunningDevice, client_arm, driven, killed
from test_crtk_command import reached

from rcmservo.hardware.crtk import messages
from rcmservo.hardware.crtk.settings import RosConnection
from rcmservo.hardware.crtk.transport import open_transport
from rcmservo.live.device_protocols import NotReady
from stalls import retry_after_stalls

pytestmark = pytest.mark.alone

DOMAIN = 91
EARLIEST_STOP_MS, LATEST_STOP_MS = -20.0, 100.0
"""Time of the stop after the client was killed."""


@pytest.fixture(scope="module")
def device() -> Iterator[RunningDevice]:
    with contextlib.closing(RunningDevice(2, DOMAIN)) as one:
        yield one


@pytest.mark.parametrize(
    "topic", [messages.MOTION_TOPICS[0], messages.MOTION_TOPICS[-1]], ids=lambda topic: topic.name
)
def test_motion_commands_of_another_client_are_detected(
    device: RunningDevice, topic: messages.Topic[Any]
) -> None:
    """For joints and for the tool pose. ROS's own programs publish reliably."""
    other, reliable = (
        open_transport(RosConnection(domain=DOMAIN)),
        replace(topic.under(NAME), lossy=False),
    )
    subscribers = 2 if topic.name == "servo_jp" else 1
    with contextlib.closing(other), contextlib.closing(client_arm(2, DOMAIN)) as arm:
        other.offer(reliable)
        assert reached(lambda: other.count_listeners(reliable) == subscribers)
        arm.enable()
        other.publish(reliable, topic.kind(time.time_ns()))
        assert reached(lambda: arm.off_reason != "")
        assert "another client sends motion commands to PSM1" in arm.off_reason


def test_every_command_is_counted_and_arrives(device: RunningDevice) -> None:
    def drive() -> tuple[dict[str, Any], int]:
        before = device.transport.heard.get(f"{NAME}/servo_jp", 0)
        counts = driven(2, DOMAIN, 1.0)
        return counts, device.transport.heard[f"{NAME}/servo_jp"] - before

    counts, heard = retry_after_stalls(drive, lambda result: result[0]["on"])
    assert counts["on"] and counts["commands"] > 60
    assert counts["sent"] + counts["withheld"] + counts["refused"] == counts["commands"]
    assert heard == counts["sent"] > 60 and counts["warned"] == 0


def test_the_arm_stops_within_100_ms_after_its_client_was_killed(device: RunningDevice) -> None:
    assert EARLIEST_STOP_MS < killed(2, DOMAIN, device, 0.13) <= LATEST_STOP_MS
    assert device.device.state == "ENABLED"


def test_the_next_client_can_enable_an_arm_that_is_on(device: RunningDevice) -> None:
    with contextlib.closing(client_arm(2, DOMAIN)) as arm:
        assert arm.is_homed()
        arm.enable()
        assert arm.measure().enabled and not arm.off_reason
    assert device.device.state == "DISABLED"


def test_a_late_subscriber_gets_the_operating_state(device: RunningDevice) -> None:
    """It may get several reports, the newest last."""
    received: list[messages.OperatingState] = []
    with contextlib.closing(client_arm(2, DOMAIN)) as arm:
        arm.enable()
    with contextlib.closing(open_transport(RosConnection(domain=DOMAIN))) as later:
        topic = messages.OPERATING_STATE.under(NAME)
        later.subscribe(topic, lambda message, writer: received.append(message))
        assert reached(lambda: bool(received) and received[-1].state == "DISABLED")
    stamps = [message.stamp for message in received]
    assert stamps == sorted(stamps)


def test_a_missing_arm_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcmservo.hardware.crtk.arm.CONNECT_TIMEOUT_S", 0.2)
    with pytest.raises(
        NotReady, match="nothing publishes PSM1/measured_js by ROS 2, domain 92 on lo"
    ):
        client_arm(2, 92)
