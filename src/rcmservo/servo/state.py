"""State of the servo from tick to tick: observations, estimate, decision, estimator memory.

The functions at the end reset parts of it. The stall rule, one of them, detects that the feature
error no longer decreases.
"""

from typing import Any, NamedTuple

import numpy as np

from rcmservo.control.exploration import ExplorationState
from rcmservo.estimation.base import Estimate, EstimatorResult
from rcmservo.estimation.camera_fit import ProjectionFit, make_initial_fit
from rcmservo.geometry.features import MAX_FEATURES
from rcmservo.interfaces import NEVER_NS, Command, Floats, Target
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into, fill
from rcmservo.numerics.structs import Row, flag, part, reals
from rcmservo.safety.causes import CAUSES, Cause
from rcmservo.safety.gate import CommandStruct, to_command
from rcmservo.safety.monitor_state import MonitorState
from rcmservo.safety.state_machine import PHASES, Mode, ModeStruct, Phase
from rcmservo.safety.target_progress import TargetProgress
from rcmservo.servo.setpoint import SetpointRow

NO_LINE_MEMORY = np.zeros((0, 3))
"""Memory of eq. (16) with an estimator that does not use it."""


class Decision(TargetProgress):
    """Decision of a tick: mode, joint rates before and after the gate, and progress."""

    mode: ModeStruct = part(ModeStruct, "phase and cause")
    command: CommandStruct = part(CommandStruct, "last command")
    v: Floats = reals(3, "mm/s", "requested velocity of marker 1")
    rates: Floats = reals(3, "rad/s, rad/s, mm/s", "requested joint rates, before the gate")


class TargetPrediction(Row):
    """Prediction of the target by the newest fit, with the markers at the joints of teaching.

    If these joints are unknown, p1 is NaN, and the other fields are those at the present joints.
    """

    p1: Floats = reals(3, "mm", "marker 1")
    markers: Floats = reals((2, 2), "px", "raw markers")
    H: Floats = reals((4, 3), "px/mm", "∂m/∂p₁")
    P: Floats = reals((3, 4), "mm/px", "(HᵀH + λ I)⁻¹ Hᵀ with the λ of the aim")
    is_determined: bool = flag("P exists")


class Workspace(Row):
    """Intermediate results of a tick, stored in the state so that a tick allocates no memory."""

    p1: Floats = reals(3, "mm", "marker 1 at the exposure of the newest frame")
    present_p1: Floats = reals(3, "mm", "marker 1 at the present joints")
    target: TargetPrediction = part(TargetPrediction, "prediction of the target")
    points: Floats = reals(
        (2, 2), "px", "raw markers in that frame, a lost one as the fit predicts"
    )
    m: Floats = reals(4, "px", "markers relative to the imaged RCM")
    m_d: Floats = reals(4, "px", "markers of the target relative to the imaged RCM")
    J_m: Floats = reals((3, 4), "rad/px, 1, 1", "∂y/∂m")
    J: Floats = reals((MAX_FEATURES, 3), "", "scaled Jacobian of the controlled features")
    error: Floats = reals(MAX_FEATURES, "", "scaled error of the controlled features")


class StoredState(Row):
    """State that a tick changes, except for the estimator's memory, in one row.

    One row is passed instead of many arrays, because every array that is passed to a compiled
    function costs as much time as the work on it.
    """

    monitor: MonitorState = part(MonitorState, "state of the checks")
    estimate: Estimate = part(Estimate, "estimate from the accepted frames")
    exploration_state: ExplorationState = part(ExplorationState, "state of the exploration")
    decision: Decision = part(Decision, "mode, requested velocity and command")
    projection_fit: ProjectionFit = part(ProjectionFit, "fit that predicts the markers")
    setpoint: SetpointRow = part(SetpointRow, "target and request of this tick")
    workspace: Workspace = part(Workspace, "intermediate results")
    estimator_result: EstimatorResult = part(EstimatorResult, "result for the newest frame")


class EstimatorMemory(NamedTuple):
    """Memory of an estimator that uses the imaged RCM of eq. (16).

    Parameters
    ----------
    line_memory : Floats
        Memory of eq. (16), that of `ImagedRcm.init`.
    memory : Any
        Memory of the estimator itself.
    """

    line_memory: Floats
    memory: Any


class EstimationState(NamedTuple):
    """Part of the state that a reset of the estimation changes.

    Parameters
    ----------
    estimate : Estimate
        Estimate from the accepted frames.
    line_memory : Floats
        Memory of eq. (16), that of `ImagedRcm.init`.
    projection_fit : ProjectionFit
        Fit that predicts the markers.
    memory : Any
        Memory of the estimator.
    exploration_state : ExplorationState
        State of the exploration.
    """

    estimate: Estimate
    line_memory: Floats
    projection_fit: ProjectionFit
    memory: Any
    exploration_state: ExplorationState


def make_initial_estimation_rows() -> dict[str, Row]:
    """Return the estimation parts of `StoredState` before the first frame, with Ĵ = 0."""
    names = "points", "o_c", "o_c_covariance", "p1", "y", "delta", "predicted_delta"
    unknown = dict.fromkeys(names, np.nan)
    infinite = dict.fromkeys(("rcm_condition", "rcm_uncertainty", "condition"), np.inf)
    estimate = Estimate.of(exposure=NEVER_NS, **infinite, **unknown)
    fit, exploration = make_initial_fit(), ExplorationState.of()
    return {"estimate": estimate, "projection_fit": fit, "exploration_state": exploration}


class State(NamedTuple):
    """State of the servo after a tick, with the command of that tick.

    `Servo.init` makes the first state and `Servo.step` the next one. A state never changes. Its
    properties give the numbers of the tick by name, such as `phase`, `cause`, `y`, `J_hat`, `v` and
    `command`; a program has no need of the four fields.

    The features y = [s r d] (3,), eq. (7)-(9), are in rad, px, px. With the markers (u₁, v₁) and
    (u₂, v₂) px measured from the imaged RCM o_c these are the angle s of the imaged tool, the
    distance r of marker 1 from o_c, and the distance d between the markers:

        s = atan2(v₂ − v₁, u₂ − u₁),    r = |(u₁, v₁)|,    d = |(u₂ − u₁, v₂ − v₁)|

    Parameters
    ----------
    stored : StoredState
        Numbers of the state in one row, with the parts `monitor`, `estimate`, `exploration_state`,
        `decision`, `projection_fit`, `setpoint`, `workspace` and `estimator_result`.
    memory : EstimatorMemory or tuple[()]
        Named tuple of `line_memory`, that of eq. (16), and `memory`, that of the estimator; empty
        for an estimator that uses only the fit of the projection.
    target : Target or None
        Target of the last tick.
    detail : str
        Addition to the sentence of the cause, such as the joint concerned.

    Notes
    -----
    Before the first accepted frame `y`, `delta`, `p1` and `o_c` are NaN, `J_hat` and `v` are zero,
    and `condition` is inf. `v` stays zero and `condition` inf until the exploration has ended. With
    an estimator that uses eq. (16), `y` and `delta` stay NaN until the lines of several frames
    determine the imaged RCM.

    The classes of `decision` and `estimation`, ``Decision`` and ``EstimationState``, are in the
    module `rcmservo.servo.state`; that of `monitor`, ``MonitorState``, is in
    `rcmservo.safety.monitor_state`.

    References
    ----------
    Section II-D of the paper for the features.
    """

    stored: StoredState
    memory: EstimatorMemory | tuple[()]
    target: Target | None = None
    detail: str = ""

    @property
    def decision(self) -> Decision:
        """Mode, requested velocity, command and progress, a `rcmservo.servo.state.Decision`."""
        return self.stored.decision

    @property
    def monitor(self) -> MonitorState:
        """State of the checks, a `rcmservo.safety.monitor_state.MonitorState`."""
        return self.stored.monitor

    @property
    def estimation(self) -> EstimationState:
        """Estimate, exploration and memory, a `rcmservo.servo.state.EstimationState`."""
        stored, fit = self.stored, self.stored.projection_fit
        line_memory, memory = self.memory or (NO_LINE_MEMORY, fit.rows)
        return EstimationState(stored.estimate, line_memory, fit, memory, stored.exploration_state)

    @property
    def mode(self) -> Mode:
        """Phase, cause and detail."""
        return Mode(**self.decision.mode.values(), detail=self.detail)

    @property
    def command(self) -> Command:
        """Command that the gate made at the last tick."""
        return to_command(self.decision.command)

    @property
    def phase(self) -> Phase:
        """Phase of the state machine."""
        return PHASES[int(self.decision.mode.phase)]

    @property
    def cause(self) -> Cause:
        """Cause of the phase; NONE in undisturbed operation."""
        return CAUSES[int(self.decision.mode.cause)]

    @property
    def text(self) -> str:
        """Sentence for the operator with phase, cause and remedy."""
        return self.mode.text

    @property
    def newest_frame(self) -> int:
        """Number of the newest frame; -1 before the first."""
        return self.monitor.newest_frame

    @property
    def accepted_frame(self) -> int:
        """Number of the newest frame that the checks accepted; -1 before the first."""
        return self.monitor.accepted_frame

    @property
    def explored(self) -> bool:
        """True once exploration has ended with an estimate to servo with."""
        return self.stored.exploration_state.is_done

    @property
    def o_c(self) -> Floats:
        """Imaged RCM (2,) in raw px, by eq. (16) or by the estimator; NaN while unknown."""
        return self.stored.estimate.o_c

    @property
    def J_hat(self) -> Floats:
        """Estimated Jacobian Ĵ (3, 3) of ẏ = Ĵ ṗ₁, eq. (14), in rad/mm, px/mm, px/mm."""
        return self.stored.estimate.J_hat

    @property
    def condition(self) -> float:
        """Condition number of the controlled Jacobian with its rows in units of 10° and 10 px.

        It is that of Ĵ for the features 'srd', and inf before the exploration has ended.
        """
        return self.stored.estimate.condition

    @property
    def p1(self) -> Floats:
        """Position (3,) of marker 1 in mm at the exposure of the newest accepted frame.

        It is NaN before the first.
        """
        return self.stored.estimate.p1

    @property
    def y(self) -> Floats:
        """Features y = [s r d] (3,), eq. (7)-(9), in rad, px, px at the exposure.

        They are the angle s of the imaged tool, the distance r of marker 1 from o_c and the
        distance d between the markers; NaN while o_c is unknown. If the estimator determines the
        imaged RCM (dlt, affine), s is the angle of the line through it that passes nearest to both
        markers, and r and d are measured along this line.
        """
        return self.stored.estimate.y

    @property
    def delta(self) -> Floats:
        """Feature error Δy = y − y_d (3,) in rad, px, px at the exposure; NaN while unknown.

        y_d are the features of the markers that the servo aims at: those of the target or, in a
        direction that the image hardly shows, of the joints of teaching.
        """
        return self.stored.estimate.delta

    @property
    def v(self) -> Floats:
        """Requested velocity v = −k Ĵ⁻¹ ∂V/∂y (3,) of marker 1 in mm/s, eq. (31).

        k (1/s) is the `gain` of the controller. The potential V = Σ Vᵢ, eq. (32), has
        Vᵢ = ½ Δyᵢ² for |Δyᵢ| < bᵢ, and bᵢ |Δyᵢ| − ½ bᵢ² beyond the bound bᵢ of the controller. With
        a feature vector other than 'srd', the pseudoinverse J⁺ (3, n) of its Jacobian J (n, 3)
        replaces Ĵ⁻¹. The inverse is damped as `SaturatedController` describes. v is zero until the
        exploration has ended.
        """
        return self.decision.v

    @property
    def pose_bound(self) -> float:
        """Distance of marker 2 from its taught position in mm that is kept with 95 %.

        It contains the noise of the markers and the errors of arm and tool, as the residuals of the
        projection fit on the way show them. Before arrival it is NaN.
        """
        return self.decision.pose_bound

    @property
    def bound_parts(self) -> Floats:
        """Parts (3,) of `pose_bound` in mm: noise of the markers, errors of the arm, way left.

        The errors are those of arm, tool and lens. The bound is the root of the sum of the squares
        of the first two, plus the third. The parts are NaN before arrival.
        """
        return self.decision.bound_parts

    @property
    def resting_rates(self) -> Floats:
        """Largest rates (3,) at which the joints rested, in rad/s, rad/s, mm/s; 0 if they moved.

        A dead zone or stiction of the drives lets a joint rest at small rates.
        """
        return self.monitor.resting_rates

    @property
    def camera_moved_at(self) -> int:
        """Time in ns at which the checks last detected a moved camera; -1 if never."""
        return self.decision.camera_moved_at


@compiled
def reset_estimation(stored: StoredState) -> None:
    """Reset estimate and exploration to the state before the first frame, with Ĵ = 0.

    The measured response of the drives remains: the arm brakes with it.
    """
    estimate, exploration = stored.estimate, stored.exploration_state
    forget_bound(stored.decision)
    fill(estimate.points, np.nan)
    fill(estimate.p1, np.nan)
    fill(estimate.o_c, np.nan)
    fill(estimate.o_c_covariance, np.nan)
    fill(estimate.y, np.nan)
    fill(estimate.delta, np.nan)
    fill(estimate.predicted_delta, np.nan)
    fill(estimate.J_hat, 0.0)
    fill(estimate.controlled_jacobian, 0.0)
    fill(estimate.controlled_error, 0.0)
    estimate.exposure, estimate.line_count = NEVER_NS, 0
    estimate.rcm_condition, estimate.condition = np.inf, np.inf
    estimate.rcm_uncertainty = np.inf
    fill(exploration.start_joints, 0.0)
    fill(exploration.sides, 0.0)
    fill(exploration.next_corner, 0.0)
    exploration.is_measuring = False
    exploration.visited_corners, exploration.start_time = 0, 0
    exploration.has_begun = exploration.has_no_room = False
    exploration.fit_is_known = exploration.is_conclusive = exploration.is_done = False


@compiled
def forget_bound(decision: Decision) -> None:
    """Set the bound of the pose and its parts to NaN, as before arrival."""
    decision.pose_bound = np.nan
    fill(decision.bound_parts, np.nan)


@compiled
def reset_estimation_except_markers(stored: StoredState) -> None:
    """Reset the estimation but preserve the last accepted positions of the markers."""
    points, p1 = stored.estimate.points.copy(), stored.estimate.p1.copy()
    reset_estimation(stored)
    copy_into(stored.estimate.points, points)
    copy_into(stored.estimate.p1, p1)


@compiled
def restart_stall_rule(decision: Decision, now: int) -> None:
    """Restart the rule that an error must decrease within some time, counted from `now` ns."""
    decision.reference_error, decision.reference_time = np.inf, now


@compiled
def request_rest(decision: Decision) -> None:
    """Set the requested velocity and joint rates to zero."""
    fill(decision.v, 0.0)
    fill(decision.rates, 0.0)
