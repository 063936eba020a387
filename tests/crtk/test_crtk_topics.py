"""Client and device over ROS 2 as it is spoken without ROS, in two processes, in wall time."""

import contextlib
from collections.abc import Iterator

import pytest
from crtk_measures import NAME, RunningDevice, client_arm, killed, streamed

from rcmservo.hardware.crtk import messages as m
from rcmservo.hardware.crtk.transport import NoTransport, opened
from rcmservo.live.lab import NotReady

pytestmark = pytest.mark.alone

DOMAIN = 91
STILL_AFTER = 100.0
"""ms"""


@pytest.fixture(scope="module")
def device() -> Iterator[RunningDevice]:
    with contextlib.closing(RunningDevice(2, DOMAIN)) as one:
        yield one


def test_every_command_is_accounted_for_and_arrives(device: RunningDevice) -> None:
    told = streamed(2, DOMAIN, device, 3.0)
    assert told["on"] and told["commands"] > 200
    assert told["sent"] + told["withheld"] + told["refused"] == told["commands"]
    assert told["heard"] == told["sent"] > 200 and told["warned"] == 0


def test_it_stands_still_100_ms_after_its_client_was_killed(device: RunningDevice) -> None:
    assert killed(2, DOMAIN, device, 0.13) <= STILL_AFTER
    assert device.device.state == "ENABLED"


def test_the_next_client_finds_it_on_and_makes_it_its_own(device: RunningDevice) -> None:
    with contextlib.closing(client_arm(2, DOMAIN)) as arm:
        assert arm.homed()
        arm.enable()
        assert arm.measure().enabled and not arm.why_off
    assert device.device.state == "DISABLED"


def test_who_comes_later_hears_how_it_is_and_once(device: RunningDevice) -> None:
    heard: list[m.OperatingState] = []
    transport = opened(2, DOMAIN, "lo")
    with contextlib.closing(transport):
        topic = m.OPERATING_STATE.under(NAME)
        with contextlib.closing(client_arm(2, DOMAIN)):
            transport.subscribe(topic, lambda said, writer: heard.append(said))
            with contextlib.closing(client_arm(2, DOMAIN)):
                pass
    assert heard[-1].state == "DISABLED"


def test_where_nobody_is_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcmservo.hardware.crtk.arm.FOUND_WITHIN", 0.2)
    with pytest.raises(NotReady, match="nobody tells PSM1/measured_js by ROS 2, domain 92 on lo"):
        client_arm(2, 92)


def test_an_interface_that_is_not_there_is_one_sentence() -> None:
    with pytest.raises(NoTransport, match="ROS 2 cannot be spoken on nowhere0, domain 93"):
        opened(2, 93, "nowhere0")
