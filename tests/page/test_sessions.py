"""Sessions: a stop lasts until the operator clears it, and the needed processes must live."""

import sys
from collections.abc import Callable
from multiprocessing import get_context
from typing import Any

import pytest

from rcmservo.errors import Stopped
from rcmservo.page.channels import PageChannels
from rcmservo.page.messages import CLEAR, STOP, Standby
from rcmservo.page.sessions import SessionLoop, StopPressed


def switch_off(began: bool) -> str:
    return "manager is off" if began else "manager was off"


def fail() -> Any:
    raise AssertionError("no session is begun here")


class StatusChannel(list[object]):
    """Status messages; once a stop can be cleared, requests follow."""

    def __init__(self, send_requests: Callable[[], None]) -> None:
        self._request = send_requests

    def send(self, messages: object) -> bool:
        self.append(messages)
        if isinstance(messages, Standby) and messages.can_clear:
            self._request()
        return True


def sessions(
    *requests: str, needed: dict[int, str] | None = None
) -> tuple[SessionLoop, PageChannels, StatusChannel]:
    channels: Any = PageChannels(get_context("spawn"))
    channels.status = StatusChannel(
        lambda: [channels.stop_requests.send(one) for one in requests] and None
    )
    return SessionLoop(channels, fail, switch_off, needed or {}, fail), channels, channels.status


def test_a_stop_is_reported_at_once_and_can_be_cleared_later() -> None:
    manager, channels, messages = sessions(CLEAR)
    channels.stop_requests.send(CLEAR)
    manager._handle_stop_request()
    assert not messages
    channels.stop_requests.send(CLEAR)
    channels.stop_requests.send(STOP)
    with pytest.raises(StopPressed, match="STOP was pressed: manager was off"):
        manager._handle_stop_request()
    assert messages == [Standby("STOP was pressed: manager was off", is_latched=True)]
    manager._await_clear("why")
    assert messages[1:] == [Standby("why", is_latched=True, can_clear=True)]


def test_a_clear_request_before_the_stop_can_be_cleared_is_ignored() -> None:
    manager, channels, _ = sessions("", CLEAR, STOP, "", needed={ended_process(): "the end"})
    channels.stop_requests.send(CLEAR)
    with pytest.raises(Stopped, match="the end"):
        manager._await_clear("why")


def ended_process() -> int:
    """Return the sentinel of a process that ends soon."""
    process = get_context("spawn").Process(target=sys.exit)
    process.start()
    PROCESSES.append(process)
    return process.sentinel


PROCESSES: list[Any] = []


def test_the_end_of_a_needed_process_is_reported_with_its_name() -> None:
    manager, _, _ = sessions(needed={ended_process(): "the stop process"})
    manager._has_been_enabled = True
    with pytest.raises(Stopped, match="the stop process has ended by itself; manager is off"):
        manager._await_clear("why")
