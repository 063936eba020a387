"""Faults of the arm: axes with a wrong gain or that creep, wrong encoders, a wrong clock, silence,
the emergency stop."""

import numpy as np

from rcmservo.interfaces import Command, Floats, Measured
from rcmservo.sim.arm import SimulatedArm
from rcmservo.sim.disturbances.schedule import Event, Schedule


class DisturbedArm:
    """An arm as the software sees it, before the true `arm`, whose drives have the faults."""

    def __init__(self, arm: SimulatedArm, schedule: Schedule) -> None:
        self.arm, self.schedule = arm, schedule
        self._answer = arm.measure()
        self._applied = np.zeros(3)
        self._overrun: set[Event] = set()
        self._began: dict[Event, float] = {}
        arm.before_step = self._suffer

    @property
    def q_true(self) -> Floats:
        """The joints (3,) as they are."""
        return self.arm.q_true

    def enable(self) -> None:
        """Switch the drives on, at rest, unless the arm hears nothing or its emergency stop is
        pressed."""
        if not self.silent and not self._is("drive_off"):
            self.arm.enable()

    def measure(self) -> Measured:
        """Return the arm's answer; while it is silent, its last one."""
        if not self.silent:
            time, q, enabled = self.arm.measure()
            self._answer = Measured(time, self._counted(q), enabled)
        return self._answer

    def apply(self, command: Command) -> Floats:
        """Pass a command on, later than it should be in a tick that overruns."""
        for event in self.schedule.begun(self.arm.time, "stall"):
            if event.word("where") == "tick" and event not in self._overrun:
                self._overrun.add(event)
                self.arm.advance_until(self.arm.time + round(event.end - event.start))
        if not self.silent and not self.schedule.killed:
            self._applied = self.arm.apply(command)
        return self._applied

    @property
    def silent(self) -> bool:
        """True while it neither answers nor hears."""
        return self._is("arm_silent")

    def _is(self, kind: str) -> bool:
        return any(self.schedule.acting(self.arm.time, kind))

    def _suffer(self) -> None:
        """Give the true arm its faults, before each step of the physics."""
        self.arm.gains[:] = 1.0, 1.0, 1.0
        for event in self.schedule.acting(self.arm.time, "gain"):
            self.arm.gains[event.axis] *= event.number("factor")
        self.arm.creep[:] = 0.0, 0.0, 0.0
        for event in self.schedule.acting(self.arm.time, "creep"):
            self.arm.creep[event.axis] += _of_axis(event, "speed")
        steps = self.schedule.acting(self.arm.time, "arm_clock")
        self.arm.clock_error = sum(round(event.number("s") * 1e9) for event in steps)
        if self._is("drive_off"):
            self.arm.watchdog.disable()

    def _counted(self, q: Floats) -> Floats:
        """The joints (3,) as wrong encoders count them."""
        q = q.copy()
        for event in self.schedule.acting(self.arm.time, "encoder"):
            there = self.arm.drive.told(self.arm.joints_at(event.start))
            began = self._began.setdefault(event, there[event.axis])
            moved = event.number("factor") * (q[event.axis] - began)
            q[event.axis] = began + moved + _of_axis(event, "offset")
        for event in self.schedule.acting(self.arm.time, "encoder_nan"):
            q[event.axis] = np.nan
        return q


def _of_axis(event: Event, name: str) -> float:
    """A parameter that is given in deg for axes 1 and 2: rad, and mm for axis 3."""
    number = event.number(name)
    return number if event.axis == 2 else float(np.radians(number))
