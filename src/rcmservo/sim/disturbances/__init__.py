"""Disturbances of a simulated laboratory, each simulated where it would arise.

kinds.py holds the table of the kinds, old_names.py the names of earlier versions. Each kind is
implemented in the file of its origin: camera_view.py (the camera's view), decoy_markers.py (objects
that look like a marker), camera_moves.py (the camera's pose and focal length), frame_delivery.py
(late or lost frames), frame_damage.py (damaged frames), arm_faults.py (the arm and its drives),
computer_faults.py (the process and the full disk). oracle.py finds the time from which a
disturbance is visible in the frames.
"""

from rcmservo.sim.disturbances.computer_faults import Killed
from rcmservo.sim.disturbances.disturbance import Disturbance, sample_disturbances
from rcmservo.sim.disturbances.kinds import DISTURBANCE_KINDS, describe_kinds, expected_causes
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
