"""Faults of the arm: axis gains, creep, encoders, clock, silence and the emergency stop."""

import numpy as np

from rcmservo.interfaces import ArmMeasurement, Command, Floats
from rcmservo.sim.arm import SimulatedArm
from rcmservo.sim.disturbances.schedule import Event, Schedule


class DisturbedArm:
    """Arm as the software observes it, in front of the true `arm`, whose drives have the faults.

    Parameters
    ----------
    arm : SimulatedArm
        True arm.
    schedule : Schedule
        Disturbances with their times.
    """

    def __init__(self, arm: SimulatedArm, schedule: Schedule) -> None:
        self.arm, self.schedule = arm, schedule
        self._answer = arm.measure()
        self._applied = np.zeros(3)
        self._overrun: set[Event] = set()
        self._first_readings: dict[Event, float] = {}
        arm.before_step = self._apply_faults

    @property
    def q_true(self) -> Floats:
        """True joints (3,)."""
        return self.arm.q_true

    def enable(self) -> None:
        """Switch the drives on, at rest, if the arm answers and no emergency stop is pressed."""
        if not self.is_silent and not self._is_active("drive_off"):
            self.arm.enable()

    def measure(self) -> ArmMeasurement:
        """Return the arm's measurement; while the arm is silent, its last one."""
        if not self.is_silent:
            time, q, enabled = self.arm.measure()
            self._answer = ArmMeasurement(time, self._encoder_readings(q), enabled)
        return self._answer

    def apply(self, command: Command) -> Floats:
        """Pass a command on, late if a disturbance makes this tick overrun."""
        for event in self.schedule.started(self.arm.time, "stall"):
            if event.word("where") == "tick" and event not in self._overrun:
                self._overrun.add(event)
                self.arm.advance_until(self.arm.time + round(event.end - event.start))
        if not self.is_silent and not self.schedule.killed:
            self._applied = self.arm.apply(command)
        return self._applied

    @property
    def is_silent(self) -> bool:
        """True while the arm neither answers nor accepts commands."""
        return self._is_active("arm_silent")

    def _is_active(self, kind: str) -> bool:
        return any(self.schedule.active(self.arm.time, kind))

    def _apply_faults(self) -> None:
        """Set the faults of the true arm, before each physics step."""
        self.arm.gains[:] = 1.0, 1.0, 1.0
        for event in self.schedule.active(self.arm.time, "gain"):
            self.arm.gains[event.axis] *= event.number("factor")
        self.arm.creep[:] = 0.0, 0.0, 0.0
        for event in self.schedule.active(self.arm.time, "creep"):
            self.arm.creep[event.axis] += _in_joint_units(event, "speed")
        steps = self.schedule.active(self.arm.time, "arm_clock")
        self.arm.clock_error = sum(round(event.number("s") * 1e9) for event in steps)
        if self._is_active("drive_off"):
            self.arm.watchdog.disable()

    def _encoder_readings(self, q: Floats) -> Floats:
        """Return the joints (3,) as the faulty encoders report them."""
        q = q.copy()
        for event in self.schedule.active(self.arm.time, "encoder"):
            reading = self.arm.drive.measured(self.arm.joints_at(event.start))
            first = self._first_readings.setdefault(event, reading[event.axis])
            change = event.number("factor") * (q[event.axis] - first)
            q[event.axis] = first + change + _in_joint_units(event, "offset")
        for event in self.schedule.active(self.arm.time, "encoder_nan"):
            q[event.axis] = np.nan
        return q


def _in_joint_units(event: Event, name: str) -> float:
    """Return a parameter, given in deg for axes 1 and 2 and in mm for axis 3, in rad or mm."""
    number = event.number(name)
    return number if event.axis == 2 else float(np.radians(number))
