"""STOP from another process, for an arm that only the servo process can disable.

supervisor ── request ──► servo process   the next command disables the drive
           ◄── is on ────                 state of the drive as the arm reports it
           ── kill ─────►                 after a time-out; the arm's own watchdog then acts
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
"""Time in ns within which the servo process must disable the drive: some ticks, and the arm's
report."""

POLL_S = 0.001
"""Interval in s at which the state of the drive is read meanwhile."""


class RemoteStop:
    """Stop request and drive state in shared memory. A process receives it when it is started.

    Parameters
    ----------
    context : BaseContext
        Start method of the processes that share it.
    """

    def __init__(self, context: BaseContext) -> None:
        self._requested: Any = context.RawValue("b", 0)
        self._on: Any = context.RawValue("b", 0)
        self._process: Any = context.RawValue("q", 0)

    @property
    def is_requested(self) -> bool:
        """True if the drive must be off and stay off."""
        return bool(self._requested.value)

    def reset(self) -> None:
        """Reset the request for a new session, which begins with the drive off."""
        self._requested.value = self._on.value = self._process.value = 0

    def set_process(self) -> None:
        """Record that this process controls the arm."""
        self._process.value = os.getpid()

    def set_drive_on(self, on: bool) -> None:
        """Record whether the drive is on, or may be."""
        self._on.value = on

    def switch_off(self, began: bool) -> str:
        """Have the drive disabled, and return a sentence on the state of the arm."""
        self._requested.value = 1
        since = time.monotonic_ns()
        if not self._on.value:
            return "the arm's drive is off"
        while time.monotonic_ns() - since < STOP_TIMEOUT_NS:
            time.sleep(POLL_S)
            if not self._on.value:
                after = (time.monotonic_ns() - since) * 1e-6
                return f"the servo switched the arm's drive off within {after:.0f} ms"
        for child in active_children():
            if child.pid == self._process.value:
                child.kill()
        return f"the servo did not switch the drive off and was killed; {rely_on_watchdog(began)}"


class RemotelyStoppableArm:
    """Arm whose next command disables the drive once a stop is requested.

    Parameters
    ----------
    arm : LabArm
        Arm of the lab.
    remote_stop : RemoteStop
        Stop request.
    report : Callable
        Function that receives the reason as soon as the drive goes off by itself.
    """

    def __init__(
        self, arm: LabArm, remote_stop: RemoteStop, report: Callable[[str], object]
    ) -> None:
        self._arm, self._remote_stop, self._report = arm, remote_stop, report
        self._enabling, self._why = False, ""
        remote_stop.set_process()

    @property
    def off_reason(self) -> str:
        return self._arm.off_reason

    def is_homed(self) -> bool:
        return self._arm.is_homed()

    def set_position(self, q: Floats) -> None:
        self._arm.set_position(q)

    def enable(self) -> None:
        """Enable the drive, unless a stop is requested. From here on it may be on."""
        self._enabling = True
        self._remote_stop.set_drive_on(True)
        if self._remote_stop.is_requested:
            raise Stopped("stopped before the drive was on")
        self._arm.enable()

    def measure(self) -> ArmMeasurement:
        measured, why = self._arm.measure(), self._arm.off_reason
        self._enabling = self._enabling and not measured.enabled
        self._remote_stop.set_drive_on(measured.enabled or self._enabling)
        if why != self._why:
            self._why = why
            if why:
                self._report(why)
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
