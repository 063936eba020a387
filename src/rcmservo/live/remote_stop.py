"""STOP from another process, for an arm that only the servo process can disable.

supervisor ── request ──► servo process   the next command disables the drive
           ◄── is on ────                 state of the drive as the arm reports it
           ── kill ─────►                 after a time-out; the arm's own watchdog then stops it
"""

import os
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import active_children
from multiprocessing.context import BaseContext
from typing import Any

import numpy as np

from rcmservo.errors import Stopped
from rcmservo.interfaces import ArmMeasurement, Command, Floats
from rcmservo.live.device_protocols import LabArm
from rcmservo.live.supervisor import rely_on_watchdog

STOP_TIMEOUT_NS = 80_000_000
"""Time in ns within which the servo process must disable the drive: a few ticks and the time until
the arm reports that its drive is off."""

POLL_S = 0.001
"""Interval in s at which the state of the drive is read within this time."""


class RemoteStop:
    """Stop request and state of the drive in shared memory.

    A process receives it when it is started, not later.

    Parameters
    ----------
    context : BaseContext
        Start method of the processes that share it.
    """

    def __init__(self, context: BaseContext) -> None:
        self._requested: Any = context.RawValue("b", 0)
        self._drive_on: Any = context.RawValue("b", 0)
        self._process_id: Any = context.RawValue("q", 0)

    @property
    def is_requested(self) -> bool:
        """True if the drive must be off and stay off."""
        return bool(self._requested.value)

    def reset(self) -> None:
        """Reset the request for a new session, which begins with the drive off."""
        self._requested.value = self._drive_on.value = self._process_id.value = 0

    def set_process(self) -> None:
        """Record that the calling process controls the arm."""
        self._process_id.value = os.getpid()

    def set_drive_on(self, is_on: bool) -> None:
        """Record if the drive is on, or may be."""
        self._drive_on.value = is_on

    def switch_off(self, was_enabled: bool) -> str:
        """Have the drive disabled, and return a sentence on the state of the arm.

        Parameters
        ----------
        was_enabled : bool
            True if the arm had been enabled.
        """
        self._requested.value = 1
        if not self._drive_on.value:
            return "the arm's drive is off"
        requested_ns = time.monotonic_ns()
        while time.monotonic_ns() - requested_ns < STOP_TIMEOUT_NS:
            time.sleep(POLL_S)
            if not self._drive_on.value:
                waited_ms = (time.monotonic_ns() - requested_ns) * 1e-6
                return f"the servo switched the arm's drive off within {waited_ms:.0f} ms"
        for child in active_children():
            if child.pid == self._process_id.value:
                child.kill()
        arm_state = rely_on_watchdog(was_enabled)
        return f"the servo did not switch the drive off and was killed; {arm_state}"


class RemotelyStoppableArm:
    """Arm whose next command disables the drive once a stop is requested.

    Parameters
    ----------
    arm : LabArm
        Arm that is controlled.
    remote_stop : RemoteStop
        Stop request.
    report : Callable
        Function that receives the reason as soon as the drive goes off by itself.
    """

    def __init__(
        self, arm: LabArm, remote_stop: RemoteStop, report: Callable[[str], object]
    ) -> None:
        self._arm, self._remote_stop, self._report = arm, remote_stop, report
        self._is_enabling, self._reported_reason = False, ""
        remote_stop.set_process()

    @property
    def off_reason(self) -> str:
        return self._arm.off_reason

    def is_homed(self) -> bool:
        return self._arm.is_homed()

    def set_position(self, q: Floats) -> None:
        self._arm.set_position(q)

    def enable(self) -> None:
        """Enable the drive, unless a stop is requested."""
        self._is_enabling = True  # from here on the drive may be on
        self._remote_stop.set_drive_on(True)
        if self._remote_stop.is_requested:
            raise Stopped("stopped before the drive was on")
        self._arm.enable()

    def measure(self) -> ArmMeasurement:
        measured, off_reason = self._arm.measure(), self._arm.off_reason
        self._is_enabling = self._is_enabling and not measured.enabled
        self._remote_stop.set_drive_on(measured.enabled or self._is_enabling)
        if off_reason and off_reason != self._reported_reason:
            self._report(off_reason)
        self._reported_reason = off_reason
        return measured

    def apply(self, command: Command) -> Floats:
        if self._remote_stop.is_requested:
            command = replace(command, rates=np.zeros(3), enabled=False)
        return self._arm.apply(command)

    def close(self) -> None:
        """Stop the arm, disable its drive and disconnect."""
        self._arm.close()
        if not self._arm.off_reason:
            self._remote_stop.set_drive_on(False)
