"""Things that go wrong in a simulated laboratory, each brought about where it would arise.

kinds.py has the table of the kinds, old_names.py those of before. A kind acts in the file of the
place where it arises: camera_view.py (the camera's view), decoy_markers.py (objects taken for a
marker), camera_moves.py (the camera's pose and focal length), frame_delivery.py (late or lost
frames), arm_faults.py (the arm and its drives), computer_faults.py (the process and the full
disk). oracle.py finds the moment from which a disturbance is visible.
"""

from rcmservo.sim.disturbances.computer_faults import Killed
from rcmservo.sim.disturbances.disturbance import Disturbance, random_disturbances
from rcmservo.sim.disturbances.kinds import KINDS, causes_of, describe
from rcmservo.sim.disturbances.schedule import Schedule

__all__ = [
    "KINDS",
    "Disturbance",
    "Killed",
    "Schedule",
    "causes_of",
    "describe",
    "random_disturbances",
]
