"""Inputs of the functions that detect the causes of a stop, and of those that describe them.

The detectors are compiled, so `TickFacts` holds structs only. The descriptions are written in
Python after a stop, from the objects of `DetailFacts`.
"""

from typing import NamedTuple

from rcmservo.control.drive_response import ResponseMeasurement
from rcmservo.control.exploration import Exploration, ExplorationState
from rcmservo.estimation.base import Estimate
from rcmservo.estimation.camera_fit import ProjectionFit
from rcmservo.geometry.kinematics import Kinematics, RcmStruct
from rcmservo.interfaces import Floats, Observation
from rcmservo.numerics.jit import compiled
from rcmservo.safety.monitor_state import MonitorState, ObservationRow
from rcmservo.safety.target_progress import TargetProgress
from rcmservo.safety.thresholds import Thresholds


class TickFacts(NamedTuple):
    """State and settings at a tick, for the compiled detectors of causes.

    Parameters
    ----------
    observation : ObservationRow
        Observation of this tick.
    monitor : MonitorState
        State of the checks.
    estimate : Estimate
        Estimate of Ĵ, of the imaged RCM and of the features.
    exploration_state : ExplorationState
        State of the exploration.
    progress : TargetProgress
        Progress towards the target.
    fit : ProjectionFit
        Fit of the camera's projection.
    drive_requested : bool
        True if the arm's drive is expected to be on.
    paused : bool
        True if the phase is PAUSED.
    target_time : int
        Time at which the target was taught, ns.
    estimator_failed : bool
        True if a user's estimator failed at this tick.
    rcm : RcmStruct
        Kinematics of the arm; the point on its tool is marker 1.
    period : int
        Time from tick to tick, ns.
    gain : float
        Gain k of the control law, eq. (31), 1/s.
    exploration : Exploration
        Settings of the exploration.
    thresholds : Thresholds
        Thresholds of the checks.
    """

    observation: ObservationRow
    monitor: MonitorState
    estimate: Estimate
    exploration_state: ExplorationState
    progress: TargetProgress
    fit: ProjectionFit
    drive_requested: bool
    paused: bool
    target_time: int
    estimator_failed: bool
    rcm: RcmStruct
    period: int
    gain: float
    exploration: Exploration
    thresholds: Thresholds


@compiled
def has_frame(facts: TickFacts) -> bool:
    """Return True if at least one frame has arrived."""
    return facts.observation.frame >= 0


class DetailFacts(NamedTuple):
    """State and settings at a stop, for the functions that describe the details of its cause.

    Parameters
    ----------
    observation : Observation
        Observation of this tick.
    monitor : MonitorState
        State of the checks.
    mechanism : Kinematics
        Kinematics of the arm.
    thresholds : Thresholds
        Thresholds of the checks.
    target_points : Floats
        Raw markers (2, 2) of the target, px.
    predicted_target : Floats
        Raw markers (2, 2) at the joints of the target by the projection fit, px.
    exploration : Exploration
        Settings of the exploration.
    disagreement : float
        Relative difference of the estimated Ĵ from that of the projection fit, by which the
        exploration ends; NaN if the fit has too few frames.
    advice : str
        Advice of the estimator after a failed exploration.
    drives : ResponseMeasurement
        Measurement of the drives while exploring.
    """

    observation: Observation
    monitor: MonitorState
    mechanism: Kinematics
    thresholds: Thresholds
    target_points: Floats
    predicted_target: Floats
    exploration: Exploration
    disagreement: float
    advice: str
    drives: ResponseMeasurement
