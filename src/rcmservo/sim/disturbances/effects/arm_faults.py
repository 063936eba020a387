"""Faults of the arm: blocked or reversed axes, creep, encoders, clock, silence, emergency stop."""

import numpy as np

from rcmservo.interfaces import ArmMeasurement, Command, Floats
from rcmservo.sim.arm import SimulatedArm
from rcmservo.sim.disturbances.schedule import Event, Schedule


class DisturbedArm:
    """Arm with the faults of a schedule, as the software reads and commands it.

    Faults of the drives act on the true `arm`; faults of the encoders change only its readings.

    Parameters
    ----------
    arm : SimulatedArm
        True arm.
    schedule : Schedule
        Disturbances with their times.
    """

    def __init__(self, arm: SimulatedArm, schedule: Schedule) -> None:
        self.arm, self.schedule = arm, schedule
        self._last_measurement = arm.measure()
        self._applied_rates = np.zeros(3)
        self._finished_stalls: set[Event] = set()
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
            self._last_measurement = ArmMeasurement(time, self._read_encoders(q), enabled)
        return self._last_measurement

    def apply(self, command: Command) -> Floats:
        """Send a command to the arm, late if the process stalls in this tick.

        Return the rates (3,) that the arm accepted last.
        """
        for event in self.schedule.started(self.arm.time, "stall"):
            if event.word("where") == "tick" and event not in self._finished_stalls:
                self._finished_stalls.add(event)
                self.arm.advance_until(self.arm.time + round(event.end - event.start))
        if not self.is_silent and not self.schedule.killed:
            self._applied_rates = self.arm.apply(command)
        return self._applied_rates

    @property
    def is_silent(self) -> bool:
        """True while the arm neither answers nor accepts commands."""
        return self._is_active("arm_silent")

    def _is_active(self, kind: str) -> bool:
        return any(self.schedule.active(self.arm.time, kind))

    def _apply_faults(self) -> None:
        """Set the faults of the true arm; it calls this before each physics step."""
        self.arm.gains[:] = 1.0, 1.0, 1.0
        for event in self.schedule.active(self.arm.time, "gain"):
            self.arm.gains[event.axis] *= event.number("factor")
        self.arm.creep[:] = 0.0, 0.0, 0.0
        for event in self.schedule.active(self.arm.time, "creep"):
            self.arm.creep[event.axis] += _convert_to_joint_units(event, "speed")
        clock_steps = self.schedule.active(self.arm.time, "arm_clock")
        self.arm.clock_error = sum(round(event.number("s") * 1e9) for event in clock_steps)
        if self._is_active("drive_off"):
            self.arm.watchdog.disable()

    def _read_encoders(self, q: Floats) -> Floats:
        """Return the joints (3,) as the faulty encoders report them."""
        q = q.copy()
        for event in self.schedule.active(self.arm.time, "encoder"):
            reading = self.arm.drive.measured(self.arm.joints_at(event.start))
            first_reading = self._first_readings.setdefault(event, reading[event.axis])
            change = event.number("factor") * (q[event.axis] - first_reading)
            q[event.axis] = first_reading + change + _convert_to_joint_units(event, "offset")
        for event in self.schedule.active(self.arm.time, "encoder_nan"):
            q[event.axis] = np.nan
        return q


def _convert_to_joint_units(event: Event, parameter: str) -> float:
    """Return a parameter in rad or mm, which is given in deg for axes 1 and 2, in mm for axis 3."""
    number = event.number(parameter)
    return number if event.axis == 2 else float(np.radians(number))
