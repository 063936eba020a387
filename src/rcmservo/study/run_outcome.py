"""How one closed loop of a study went, by the truth."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rcmservo.interfaces import Floats
from rcmservo.safety.causes import CAUSES, Cause
from rcmservo.safety.state_machine import PHASES, Phase
from rcmservo.sim.scene import Scene

LAST = 1.0
"""s at the end of a run over which its pose error is the root mean square."""

STOPPING = [PHASES.index(phase) for phase in (Phase.HOLD, Phase.PAUSED, Phase.FAULT)]
SERVO = PHASES.index(Phase.SERVO)


@dataclass(frozen=True, eq=False)
class StudyRun:
    """How one closed loop went: numbers of every tick.

    Parameters
    ----------
    seed : int
        That its scene and noise were drawn from.
    rate : float
        Ticks per s.
    error : Floats
        (n,) mm from marker 2 to where it was shown, by the truth.
    phases : NDArray[np.int8]
        (n,) places in Phase.
    causes : NDArray[np.int8]
        (n,) places in Cause.
    bound : float
        mm, rms: the Cramér-Rao bound of the error, at the laboratory's noise, of a target that was
        shown so, with all frames of the closed loop; NaN where the noise is not known.
    scene : Scene
        Where it took place, as it was drawn.
    engine : str
        Engine that made it, where that is of interest.
    jacobian_error : float
        Median scaled error of Ĵ while servoing; NaN on the compiled twin, or without a Ĵ.
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

    def first_within(self, mm: float) -> float:
        """S until the error was first at most so large; inf if it never was."""
        there = np.flatnonzero(self.error <= mm)
        return float(there[0] / self.rate) if len(there) else np.inf

    @property
    def pose_error(self) -> float:
        """mm: the root mean square of the error over the last second."""
        return float(np.sqrt(np.mean(self.error[-round(LAST * self.rate) :] ** 2)))

    @property
    def explored(self) -> float:
        """S until the tool was first servoed, its exploration behind it; inf if it never was."""
        servoed = np.flatnonzero(self.phases == SERVO)
        return float(servoed[0] / self.rate) if len(servoed) else np.inf

    @property
    def held(self) -> Cause:
        """What the tool stood still for at the last tick; NONE if it did not."""
        return CAUSES[int(self.causes[-1])] if int(self.phases[-1]) in STOPPING else Cause.NONE

    def until(self, time: float) -> "StudyRun":
        """The run had it ended so many s after its first tick; its bound stays that of all
        frames.
        """
        n = round(min(time * self.rate, len(self.error)))
        return replace(self, error=self.error[:n], phases=self.phases[:n], causes=self.causes[:n])

    @cached_property
    def stops(self) -> list[tuple[float, Cause]]:
        """S and cause of every stop: HOLD, PAUSED or FAULT after what was none of them."""
        stands = np.isin(self.phases, STOPPING).astype(np.int8)
        begun = np.flatnonzero(np.diff(stands, prepend=0) > 0)
        return [(float(k / self.rate), CAUSES[self.causes[k]]) for k in begun]

    @property
    def began(self) -> bool:
        """Whether the tool was ever to move."""
        return bool((self.phases == SERVO).any())

    @property
    def unnoticed(self) -> float:
        """mm: the most by which the error grew while the tool servoed and no cause was named,
        beyond the least that it had been since it began to. Every way that is not straight has a
        little of it; a method that leads away without a word has much.
        """
        servoing = (self.phases == SERVO).astype(np.int8)
        edges = np.flatnonzero(np.diff(servoing, prepend=0, append=0))
        most = 0.0
        for begin, end in edges.reshape(-1, 2):
            error = self.error[begin:end]
            grown = error - np.minimum.accumulate(error)
            quiet = self.causes[begin:end] == Cause.NONE.place
            most = max(most, float(grown[quiet].max(initial=0.0)))
        return most
