"""STOP for an arm that nobody can switch off but the servo's own process.

supervisor ── pulls ──► servo process     the next command switches the drive off
           ◄── on ─────                   what the arm tells then
           ── kills ──►                   where it does not: then the arm's own watchdog acts
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
from rcmservo.interfaces import Command, Floats, Measured
from rcmservo.live.lab import LabArm
from rcmservo.live.supervisor import left_to_its_watchdog

QUICK = 80_000_000
"""ns within which the servo's process must have switched the drive off: some ticks, and the arm's
answer."""

LOOK = 0.001
"""s between looks at whether it has."""


class Leash:
    """What the servo's process and whoever stops it share. It is handed to a process when that is
    started."""

    def __init__(self, context: BaseContext) -> None:
        self._pulled: Any = context.RawValue("b", 0)
        self._on: Any = context.RawValue("b", 0)
        self._process: Any = context.RawValue("q", 0)

    @property
    def pulled(self) -> bool:
        """Whether the drive is to be off, and to stay so."""
        return bool(self._pulled.value)

    def renew(self) -> None:
        """Another session begins, with the drive off."""
        self._pulled.value = self._on.value = self._process.value = 0

    def hold(self) -> None:
        """This process has the arm."""
        self._process.value = os.getpid()

    def tell(self, on: bool) -> None:
        """Whether the drive is on, or may be."""
        self._on.value = on

    def off(self, began: bool) -> str:
        """Have the drive switched off, and say in words how the arm stands."""
        self._pulled.value = 1
        since = time.monotonic_ns()
        if not self._on.value:
            return "the arm's drive is off"
        while time.monotonic_ns() - since < QUICK:
            time.sleep(LOOK)
            if not self._on.value:
                after = (time.monotonic_ns() - since) * 1e-6
                return f"the servo has switched the arm's drive off within {after:.0f} ms"
        for child in active_children():
            if child.pid == self._process.value:
                child.kill()
        return (
            f"the servo did not switch the drive off and was killed; {left_to_its_watchdog(began)}"
        )


class LeashedArm:
    """An arm that is switched off with its next command once its leash is pulled. Why its drive
    went off by itself is ``told`` as soon as it is known."""

    def __init__(self, arm: LabArm, leash: Leash, told: Callable[[str], object]) -> None:
        self._arm, self._leash, self._told = arm, leash, told
        self._coming, self._why = False, ""
        leash.hold()

    @property
    def why_off(self) -> str:
        return self._arm.why_off

    def homed(self) -> bool:
        return self._arm.homed()

    def define(self, q: Floats) -> None:
        self._arm.define(q)

    def enable(self) -> None:
        """Switch the drive on, unless the leash is pulled. From here on it may be on."""
        self._coming = True
        self._leash.tell(True)
        if self._leash.pulled:
            raise Stopped("stopped before the drive was on")
        self._arm.enable()

    def measure(self) -> Measured:
        measured, why = self._arm.measure(), self._arm.why_off
        self._coming = self._coming and not measured.enabled
        self._leash.tell(measured.enabled or self._coming)
        if why != self._why:
            self._why = why
            if why:
                self._told(why)
        return measured

    def apply(self, command: Command) -> Floats:
        if self._leash.pulled:
            command = replace(command, rates=np.zeros(3), enabled=False)
        return self._arm.apply(command)

    def close(self) -> None:
        """Bring it to rest, switch it off, and hang up."""
        self._arm.close()
        if not self._arm.why_off:
            self._leash.tell(False)
