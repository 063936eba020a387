"""Disturbances: simulated faults of the arm, the camera and the computer.

To add one, start in disturbance_kinds.py. It holds one row for each kind of disturbance, and names
the file in effects/ that simulates it.
"""

from rcmservo.sim.disturbances.disturbance import Disturbance, sample_disturbances
from rcmservo.sim.disturbances.disturbance_kinds import (
    DISTURBANCE_KINDS,
    describe_kinds,
    expected_causes,
)
from rcmservo.sim.disturbances.effects.computer_faults import Killed
from rcmservo.sim.disturbances.schedule import Schedule

__all__ = [
    "DISTURBANCE_KINDS",
    "Disturbance",
    "Killed",
    "Schedule",
    "describe_kinds",
    "expected_causes",
    "sample_disturbances",
]
