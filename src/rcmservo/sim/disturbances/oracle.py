"""An onlooker who knows the true camera: from which moment on what goes wrong can be seen in the
frames, and how far the tool goes wrong after that without a word.

    innovation = (markers delivered − projection at the true joints) / σ

The projection is that of the camera as it was when the servo began to learn; the joints are the
true ones at the moment at which the frame is said to have been exposed; σ is the markers' noise.
No servo can know better than that, so what it says later it could have said no sooner than here.
"""

import numpy as np

from rcmservo.guard.causes import Cause
from rcmservo.guard.states import Phase
from rcmservo.interfaces import Floats, Observation
from rcmservo.loop.tick import Tick
from rcmservo.sim.ground_truth import Truth

LOUD = 5.0
"""The largest normalised coordinate of an innovation from which on a frame is not noise."""

LASTING = 300_000_000
"""ns for which every delivered frame must be so."""

STOPPED = Phase.HOLD, Phase.PAUSED, Phase.FAULT


class Oracle:
    """Sees a disturbance as soon as it can be seen."""

    visible: int | None
    """Time at which it could be seen first, ns; None while it could not."""

    def __init__(self, truth: Truth, sigma: float) -> None:
        """`sigma` px is the markers' noise. What is learnt from now on is learnt with the camera as
        it is now."""
        self._truth, self._sigma = truth, sigma
        self.learn()

    def learn(self) -> None:
        """From now on the servo learns the camera as it is now."""
        self._optics = self._truth.optics
        self.look_away()

    def look_away(self) -> None:
        """Restart: it must be seen for as long again."""
        self.visible: int | None = None
        self._frame, self._since = -1, None

    def innovation(self, seen: Observation) -> Floats:
        """Of the newest frame, (2, 2), normalised; NaN where a marker is not seen."""
        markers = self._truth.markers(seen.exposure)
        return (seen.points - self._optics.project(markers)) / self._sigma

    def look(self, seen: Observation) -> None:
        """Look at the observation of a tick."""
        if seen.frame in (-1, self._frame):
            return
        self._frame = seen.frame
        innovation = np.abs(self.innovation(seen))
        if not np.nan_to_num(innovation).max() >= LOUD:
            self._since = None
            return
        self._since = seen.now if self._since is None else self._since
        if self.visible is None and seen.now - self._since >= LASTING:
            self.visible = seen.now


class Unnoticed:
    """How far the tool goes wrong after that could be seen: by how much the true error, mm from
    where the target was shown, grows while the servo servoes and names no cause.

    A stop is a word. If the tool goes on afterwards, what is wrong must be visible anew.
    """

    grown: float
    """mm, the most beyond the true error at the moment at which it could be seen first."""

    def __init__(self, oracle: Oracle) -> None:
        self.oracle, self.grown = oracle, 0.0
        self._then: float | None = None

    def look(self, tick: Tick, error: float) -> None:
        """Look at a tick after which the true error is so many mm."""
        state = tick.state
        if state.phase in STOPPED:
            self.oracle.look_away()
        else:
            self.oracle.look(tick.seen)
        if self.oracle.visible is None:
            self._then = None
            return
        self._then = error if self._then is None else self._then
        if state.phase is Phase.SERVO and state.cause is Cause.NONE:
            self.grown = max(self.grown, error - self._then)
