"""Contract of a clock: whole ns, which advance while someone waits and never go back."""

from numbers import Integral
from typing import cast

from rcmservo.interfaces import Clock
from rcmservo.testing.violations import WatchedPart

TRIAL_WAIT_NS = 20_000_000
"""Time in ns for which the check waits."""

CLOCK_RESOLUTION_NS = 1_000_000
"""Largest time in ns by which a wait may end early: the time step of a simulation."""


def check_clock(clock: Clock) -> None:
    """Check a clock against its contract.

    Parameters
    ----------
    clock : Clock
        Clock of a plant, such as that of a simulation.

    Raises
    ------
    ContractViolation
        If its time is no whole number, does not advance in `wait_until`, or goes back.
    """
    part = WatchedPart(clock)
    began = _read_time(part)
    part.call("wait_until", began + TRIAL_WAIT_NS)
    ended = _read_time(part)
    finding = f"returned after {(ended - began) * 1e-6:g} ms of its clock, expected 20 ms"
    has_advanced = ended - began >= TRIAL_WAIT_NS - CLOCK_RESOLUTION_NS
    part.require(has_advanced, "wait_until", finding)
    part.call("wait_until", began)
    part.require(_read_time(part) >= ended, "now", "went back after a wait for a past time")


def _read_time(part: WatchedPart) -> int:
    time = part.call("now")
    part.require(isinstance(time, Integral), "now", f"returned {time!r}, expected whole ns")
    return cast(int, time)
