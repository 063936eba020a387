"""Oracle: detector of disturbances that knows the true camera, to judge the servo's reports.

    innovation = (delivered markers − projection at the true joints) / σ

The projection is that of the camera when the servo began to estimate. The joints are the true ones
at the reported time of the exposure. σ is the standard deviation of the markers' noise. No servo
knows more, so no servo can report a disturbance reliably before the oracle does. `UnnoticedGrowth`
measures the growth of the true error after that time while the servo reports no cause.
"""

import numpy as np

from rcmservo.interfaces import Floats, Observation
from rcmservo.loop.tick import Tick
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.sim.ground_truth import GroundTruth

INNOVATION_THRESHOLD = 5.0
"""Innovation, in standard deviations, that noise alone does not reach."""

MIN_DURATION_NS = 300_000_000
"""Time (ns) for which the innovation of every delivered frame must exceed
`INNOVATION_THRESHOLD`."""

STOPPED_PHASES = Phase.HOLD, Phase.PAUSED, Phase.FAULT
"""Phases in which the servo does not move the tool to the target."""


class Oracle:
    """Detector of disturbances that knows the true camera and the true joints.

    Parameters
    ----------
    truth : GroundTruth
        Ground truth of the run.
    sigma : float
        Standard deviation (px) of the markers' noise.
    """

    visible_since: int | None
    """Time (ns) at which a disturbance has been visible for `MIN_DURATION_NS`; None before."""

    def __init__(self, truth: GroundTruth, sigma: float) -> None:
        self._truth, self._sigma = truth, sigma
        self.restart()

    def restart(self) -> None:
        """Restart with the present camera as the one that the servo estimates."""
        self._estimated_camera = self._truth.camera_model
        self.reset()

    def reset(self) -> None:
        """Restart the time for which a disturbance must be visible: `MIN_DURATION_NS`."""
        self.visible_since = None
        self._last_frame, self._exceeded_since = -1, None

    def innovation(self, observation: Observation) -> Floats:
        """Return the normalised innovation (2, 2) of a frame, NaN where a marker is not found."""
        markers = self._truth.markers(observation.exposure)
        return (observation.points - self._estimated_camera.project(markers)) / self._sigma

    def update(self, observation: Observation) -> None:
        """Update with the observation of a tick."""
        if observation.frame in (-1, self._last_frame):
            return
        self._last_frame, now = observation.frame, observation.now
        innovation = np.abs(self.innovation(observation))
        if not np.nan_to_num(innovation).max() >= INNOVATION_THRESHOLD:
            self._exceeded_since = None
            return
        self._exceeded_since = now if self._exceeded_since is None else self._exceeded_since
        if self.visible_since is None and now - self._exceeded_since >= MIN_DURATION_NS:
            self.visible_since = now


class UnnoticedGrowth:
    """Growth of the true error while a disturbance is visible and the servo reports no cause.

    A stop counts as a report. If the servo continues afterwards, the disturbance must become
    visible again.

    Parameters
    ----------
    oracle : Oracle
        Detector of the disturbance.
    """

    growth: float
    """Largest growth (mm) of the true error since the disturbance became visible."""

    def __init__(self, oracle: Oracle) -> None:
        self.oracle, self.growth = oracle, 0.0
        self._initial_error_mm: float | None = None

    def update(self, tick: Tick, error: float) -> None:
        """Update with a tick and the true error (mm) after it."""
        state = tick.state
        if state.phase in STOPPED_PHASES:
            self.oracle.reset()
        else:
            self.oracle.update(tick.observation)
        if self.oracle.visible_since is None:
            self._initial_error_mm = None
            return
        if self._initial_error_mm is None:
            self._initial_error_mm = error
        if state.phase is Phase.SERVO and state.cause is Cause.NONE:
            self.growth = max(self.growth, error - self._initial_error_mm)
