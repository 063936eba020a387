"""How far the tool truly is from a target, by what only the simulation knows."""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.body import Body
from rcmservo.sim.processes.motion_log import MotionLog
from rcmservo.sim.rig import RigSettings


class TrueError:
    """‖p₂ − p_d‖ mm for the joints (3,) that the arm told while a target was shown. It is handed to
    a process when that is started."""

    def __init__(self, settings: RigSettings, log: MotionLog) -> None:
        self._body, self._log = Body(settings.mechanism, settings.tool), log
        self._drive = settings.drive

    def __call__(self, shown: Floats) -> float:
        now, there = (
            self._body.points(q)[1] for q in (self._log.last()["q"], self._drive.true(shown))
        )
        away: Floats = now - there
        return float(np.linalg.norm(away))
