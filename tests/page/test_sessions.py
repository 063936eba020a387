"""A stop stays until a person clears it who has seen it, and nothing goes on without the processes
that hear and show.
"""

import sys
from collections.abc import Callable
from multiprocessing import get_context
from typing import Any

import pytest

from rcmservo.errors import Stopped
from rcmservo.page.channels import Desk
from rcmservo.page.messages import CLEAR, STOP, Standby
from rcmservo.page.sessions import Sessions, StopPressed


def switch_off(began: bool) -> str:
    return "it is off" if began else "it was off"


def fail() -> Any:
    raise AssertionError("no session is begun here")


class StatusChannel(list[object]):
    """What is said to the page; once a stop can be cleared, somebody rings."""

    def __init__(self, ring: Callable[[], None]) -> None:
        self._request = ring

    def put(self, said: object) -> bool:
        self.append(said)
        if isinstance(said, Standby) and said.can_clear:
            self._request()
        return True


def sessions(
    *rings: str, needed: dict[int, str] | None = None
) -> tuple[Sessions, Desk, StatusChannel]:
    desk: Any = Desk(get_context("spawn"))
    desk.said = StatusChannel(lambda: [desk.bell.put(ring) for ring in rings] and None)
    return Sessions(desk, fail, switch_off, needed or {}, fail), desk, desk.said


def test_a_stop_is_reported_at_once_and_can_be_cleared_later() -> None:
    it, desk, said = sessions(CLEAR)
    desk.bell.put(CLEAR)
    it._handle_stop_request()
    assert not said
    desk.bell.put(CLEAR)
    desk.bell.put(STOP)
    with pytest.raises(StopPressed, match="STOP was pressed: it was off"):
        it._handle_stop_request()
    assert said == [Standby("STOP was pressed: it was off", is_latched=True)]
    it._latch("why")
    assert said[1:] == [Standby("why", is_latched=True, can_clear=True)]


def test_a_clear_request_before_the_stop_can_be_cleared_is_ignored() -> None:
    it, desk, _ = sessions("", CLEAR, STOP, "", needed={ended_process(): "the end"})
    desk.bell.put(CLEAR)
    with pytest.raises(Stopped, match="the end"):
        it._latch("why")


def ended_process() -> int:
    """The sentinel of a process that is over soon."""
    process = get_context("spawn").Process(target=sys.exit)
    process.start()
    PROCESSES.append(process)
    return process.sentinel


PROCESSES: list[Any] = []


def test_the_end_of_a_needed_process_is_reported_with_its_name() -> None:
    it, _, _ = sessions(needed={ended_process(): "the ear"})
    it._has_begun = True
    with pytest.raises(Stopped, match="the ear has ended by itself; it is off"):
        it._latch("why")
