"""Things that go wrong in a simulated laboratory, each brought about where it would arise.

kinds.py lists what can go wrong. What the kinds do is in the file of the place where they arise:
camera_view.py (what the camera sees), likenesses.py (what it takes for a marker), camera_moves.py
(where it stands), frame_delivery.py (how its frames come), arm_faults.py (the arm and its drives),
stalls.py (the process) and disk.py (the disk that fills up). oracle.py tells when it could be seen.
"""

from rcmservo.sim.disturb.disturbance import Disturbance, random_disturbances
from rcmservo.sim.disturb.kinds import KINDS, causes_of, describe
from rcmservo.sim.disturb.schedule import Schedule
from rcmservo.sim.disturb.stalls import Killed

__all__ = [
    "KINDS",
    "Disturbance",
    "Killed",
    "Schedule",
    "causes_of",
    "describe",
    "random_disturbances",
]
