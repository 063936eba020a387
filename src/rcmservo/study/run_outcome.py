"""Outcome of one closed loop of a study, measured against the true position of the tool."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rcmservo.interfaces import Floats
from rcmservo.recording.final_pose import FINAL_WINDOW_S
from rcmservo.safety.causes import CAUSES, Cause
from rcmservo.safety.state_machine import PHASES, Phase
from rcmservo.sim.scene import Scene

STOPPED_PHASES = [PHASES.index(phase) for phase in (Phase.HOLD, Phase.PAUSED, Phase.FAULT)]
SERVO_PHASE = PHASES.index(Phase.SERVO)
"""Codes of phases in a run: their indices in `PHASES`."""


@dataclass(frozen=True, eq=False)
class StudyRun:
    """Outcome of one closed loop: error, phase and cause at every tick.

    Parameters
    ----------
    seed : int
        Seed of the scene and the noise.
    rate : float
        Ticks per second.
    error : Floats
        True distance (n,) from marker 2 to its position at the target, mm.
    phases : NDArray[np.int8]
        Index (n,) of the phase in ``PHASES`` of `rcmservo.safety.state_machine`.
    causes : NDArray[np.int8]
        Index (n,) of the cause in ``CAUSES`` of `rcmservo.safety.causes`.
    bound : float
        Cramér-Rao bound of the error, rms in mm, for the noise of the laboratory, the frames of the
        taught target and all frames of the loop; NaN if the noise is unknown.
    scene : Scene
        Camera, tool, start and target.
    engine : str
        Engine that made the run; empty if it is not noted, as in a comparison.
    jacobian_error : float
        Median scaled error of Ĵ in SERVO; NaN where it is not measured, as in a comparison.
    pose_bound : float
        Error at the end that is kept with 95 % by the servo's own estimate, mm; NaN if the tool has
        not arrived, or where it is not measured.
    """

    seed: int
    rate: float
    error: Floats
    phases: NDArray[np.int8]
    causes: NDArray[np.int8]
    bound: float
    scene: Scene
    engine: str = ""
    jacobian_error: float = np.nan
    pose_bound: float = np.nan

    def first_within(self, mm: float) -> float:
        """Return the time of the first tick with an error up to `mm`, in s; inf without one."""
        ticks = np.flatnonzero(self.error <= mm)
        return float(ticks[0] / self.rate) if len(ticks) else np.inf

    @property
    def pose_error(self) -> float:
        """Root mean square of the error over the last second, mm."""
        return float(np.sqrt(np.mean(self.error[-round(FINAL_WINDOW_S * self.rate) :] ** 2)))

    @property
    def explored(self) -> float:
        """Time of the first tick in SERVO, after the exploration, in s; inf without one."""
        ticks = np.flatnonzero(self.phases == SERVO_PHASE)
        return float(ticks[0] / self.rate) if len(ticks) else np.inf

    @property
    def held(self) -> Cause:
        """Cause of the stop at the last tick; NONE if the tool is not stopped."""
        is_stopped = int(self.phases[-1]) in STOPPED_PHASES
        return CAUSES[int(self.causes[-1])] if is_stopped else Cause.NONE

    def until(self, time: float) -> "StudyRun":
        """Return the first `time` s of the run; the bound remains that of all frames."""
        n = round(min(time * self.rate, len(self.error)))
        return replace(self, error=self.error[:n], phases=self.phases[:n], causes=self.causes[:n])

    @cached_property
    def stops(self) -> list[tuple[float, Cause]]:
        """Time (s) and cause of every stop: a change from any phase to HOLD, PAUSED or FAULT."""
        is_stopped = np.isin(self.phases, STOPPED_PHASES).astype(np.int8)
        first_ticks = np.flatnonzero(np.diff(is_stopped, prepend=0) > 0)
        return [(float(k / self.rate), CAUSES[self.causes[k]]) for k in first_ticks]

    @property
    def began(self) -> bool:
        """True if the run ever reached SERVO."""
        return bool((self.phases == SERVO_PHASE).any())

    @property
    def unnoticed(self) -> float:
        """Largest growth of the error in SERVO without a cause, mm.

        The growth counts from the smallest error since the servo entered SERVO. Every path that is
        not straight has a little of it; a method that diverges without raising a cause has much.
        """
        in_servo = (self.phases == SERVO_PHASE).astype(np.int8)
        edges = np.flatnonzero(np.diff(in_servo, prepend=0, append=0))
        largest_growth = 0.0
        for begin, end in edges.reshape(-1, 2):
            error = self.error[begin:end]
            growth = error - np.minimum.accumulate(error)
            has_no_cause = self.causes[begin:end] == Cause.NONE.code
            largest_growth = max(largest_growth, float(growth[has_no_cause].max(initial=0.0)))
        return largest_growth
