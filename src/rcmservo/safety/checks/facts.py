"""Facts of a tick for the detectors, and for the details of causes."""

from typing import NamedTuple

from rcmservo.control.exploration import Exploration, Exploring
from rcmservo.estimation.base import Estimate
from rcmservo.estimation.projection_fit import Prospect
from rcmservo.geometry.kinematics import Kinematics, Rcm
from rcmservo.interfaces import Observation
from rcmservo.numerics.jit import compiled
from rcmservo.safety.monitor_state import ObservationRow, Watch
from rcmservo.safety.target_progress import TargetProgress
from rcmservo.safety.thresholds import Thresholds


class TickFacts(NamedTuple):
    """Facts of a tick that a detector may read, in compiled functions.

    Parameters
    ----------
    seen : ObservationRow
        The observation.
    watch : Watch
        State of the checks.
    estimate : Estimate
        Estimate of Ĵ, imaged RCM and features.
    tour : Exploring
        State of the exploration.
    progress : TargetProgress
        Progress towards the target.
    prospect : Prospect
        Fit of the camera's projection.
    drive_requested : bool
        True if the arm's drive should be on.
    paused : bool
        True in the phase PAUSED.
    taught : int
        ns, when the target was taught.
    estimator_failed : bool
        True if a user's estimator failed at this tick.
    rcm : Rcm
        Mechanism, with marker 1 as the point on its tool.
    period : int
        ns from tick to tick.
    gain : float
        1/s, k of the law (31).
    max_rcm_condition : float
        Condition of eq. (16) up to which o_c is known.
    exploration : Exploration
        Settings of the exploration.
    thresholds : Thresholds
        Values from which on something is a fault.
    """

    seen: ObservationRow
    watch: Watch
    estimate: Estimate
    tour: Exploring
    progress: TargetProgress
    prospect: Prospect
    drive_requested: bool
    paused: bool
    taught: int
    estimator_failed: bool
    rcm: Rcm
    period: int
    gain: float
    max_rcm_condition: float
    exploration: Exploration
    thresholds: Thresholds


@compiled
def has_frame(c: TickFacts) -> bool:
    """Return True if any frame has been used."""
    return c.seen.frame >= 0


class DetailFacts(NamedTuple):
    """Facts of a tick that the detail of a cause may be made of.

    Parameters
    ----------
    seen : Observation
        The observation.
    watch : Watch
        State of the checks.
    mechanism : Kinematics
        The arm's kinematics.
    thresholds : Thresholds
        Values from which on something is a fault.
    advice : str
        Advice of the estimator for an exploration that fails.
    """

    seen: Observation
    watch: Watch
    mechanism: Kinematics
    thresholds: Thresholds
    advice: str
