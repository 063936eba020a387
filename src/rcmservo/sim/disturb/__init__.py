"""Things that go wrong in a simulated laboratory, each brought about at the interface where it
would arise."""

from rcmservo.sim.disturb.kinds import KINDS, Disturbance, causes_of, describe, random_disturbances
from rcmservo.sim.disturb.process import Killed
from rcmservo.sim.disturb.schedule import Schedule

__all__ = [
    "KINDS",
    "Disturbance",
    "Killed",
    "Schedule",
    "causes_of",
    "describe",
    "random_disturbances",
]
