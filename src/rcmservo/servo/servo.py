"""Servo: features, imaged RCM, estimation, controller and gate composed into one pure step.

It has no clock, input or output: the same state and observation always give the same result. The
compiled part of a step is one function in tick.py. Estimators and feature vectors that do not
compile are called from here.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, cast

import numpy as np

from rcmservo.constraints import Checked
from rcmservo.control.exploration import Exploration
from rcmservo.control.feature_vectors import FEATURE_VECTORS, FeatureVector, MarkerPair
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import require
from rcmservo.estimation.base import Estimator, EstimatorKernel, EstimatorResult, Sample
from rcmservo.estimation.camera_fit_prediction import filter_markers
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.geometry.features import INTERPRETED_CODE
from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.geometry.kinematics import (
    Kinematics,
    RcmStruct,
    SphericalRcm,
    compute_position,
)
from rcmservo.geometry.tool import RigidTool, Tool
from rcmservo.interfaces import NEVER_NS, Floats, Observation, Target, observation_numbers
from rcmservo.numerics.structs import Row, Rows, copy_row, replace_fields, to_row
from rcmservo.safety.causes import EXPLAINED_BY_ARM, EXPLAINED_BY_MOTION, EXPLAINED_BY_REPORTS
from rcmservo.safety.checks.devices import describe_slow_reports
from rcmservo.safety.checks.drift import describe_arm_error
from rcmservo.safety.checks.facts import DetailFacts
from rcmservo.safety.gate import CommandStruct, Gate
from rcmservo.safety.monitor_state import MonitorState, initial_monitor_state
from rcmservo.safety.state_machine import REQUESTS, Mode, ModeStruct, Phase, Request
from rcmservo.safety.target_checks import require_joints_within_limits, require_possible_markers
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.kernel_parameters import KernelParameters
from rcmservo.servo.state import (
    Decision,
    EstimatorMemory,
    State,
    StoredState,
    make_initial_estimation_rows,
)
from rcmservo.servo.tick import begin_tick, finish_tick, make_compiled_tick
from rcmservo.servo.update_estimate import FRAME_UPDATES
from rcmservo.servo.user_estimator import (
    check_estimator,
    find_kernel,
    guard_estimator,
    read_failure,
    reset_slowest,
)
from rcmservo.servo.user_features import check_feature_vector, linearise

ZERO_RATES = np.zeros(3)
"""Joint rates (3,) of an arm at rest."""


def make_default_tool() -> Tool:
    """Return a shaft with two balls 30 mm apart, the tool of the simulated laboratory."""
    return RigidTool(spacing=30.0)


WARM_UP_TICKS = 8
"""Number of made-up ticks that compile all functions of a step."""


@dataclass(frozen=True)
class Servo(Checked):
    """Settings and step of the servo: kinematics and tool, and one part per block of the paper.

    `init` makes the first state and `step` the next one. Both are pure functions. One step measures
    the features y = [s r d] (3,) in rad, px, px, eq. (7)-(9). It estimates the imaged RCM o_c (2,)
    in raw px by eq. (16) and the Jacobian Ĵ (3, 3) in rad/mm, px/mm, px/mm of ẏ = Ĵ v, eq. (14).
    It then computes the velocity v (3,) in mm/s of marker 1, eq. (31),

        v = −k Ĵ⁻¹ ∂V/∂y

    k (1/s) is the `gain` of the controller. V = Σ Vᵢ is the saturated potential of the error
    Δy = y − y_d from the features y_d (3,) of the target, with the `bounds` bᵢ of the controller in
    rad, px, px, eq. (32):

        Vᵢ = ½ Δyᵢ²             if |Δyᵢ| < bᵢ
        Vᵢ = bᵢ |Δyᵢ| − ½ bᵢ²   otherwise

    The joints q (3,) are in rad, rad, mm. The gate bounds the joint rates (3,) in rad/s, rad/s,
    mm/s that move marker 1 with v. `SaturatedController` describes the damping of Ĵ⁻¹ and the other
    feature vectors.

    Parameters
    ----------
    mechanism : Kinematics
        Kinematics of the arm, eq. (1)-(2), with its joint limits: `SphericalRcm` or `PitchYawRcm`;
        ``SphericalRcm()`` by default. `run` takes that of its rig.
    tool : Tool
        Positions of the markers on the tool: `RigidTool` or `ScaledTool`; by default
        ``RigidTool(spacing=30.0)``. `run` takes that of its rig.
    estimator : Estimator
        Estimator of Ĵ, eq. (17)-(30): a class whose name ends in Estimator, or a user-defined one;
        ``DltEstimator()`` by default.
    controller : SaturatedController
        Controller, eq. (31)-(32); ``SaturatedController()`` by default.
    exploration : Exploration
        First motion, while no estimate is known; ``Exploration()`` by default.
    imaged_rcm : ImagedRcm
        Estimation of the imaged RCM, eq. (16); ``ImagedRcm()`` by default. Estimators that
        determine the imaged RCM (dlt, affine) replace it.
    gate : Gate
        Bounds on every command; ``Gate()`` by default.
    thresholds : Thresholds
        Thresholds of the checks; ``Thresholds()`` by default.
    rate : float
        Ticks per second, Hz: at least two within the gate's deadline (40 Hz for 0.05 s), at most
        1000.

    Raises
    ------
    BadInput
        If `rate` is out of range, or if the estimator does not estimate what the features of the
        controller need.

    References
    ----------
    Sections II and III of the paper.

    Examples
    --------
    A servo with a smaller gain than by default, at 200 ticks per second::

        servo = rs.Servo(
            rs.SphericalRcm(),
            rs.RigidTool(spacing=30.0),
            controller=rs.SaturatedController(gain=4.0),
            rate=200.0,
        )
    """

    mechanism: Kinematics = field(default_factory=SphericalRcm)
    tool: Tool = field(default_factory=make_default_tool)
    estimator: Estimator = field(default_factory=DltEstimator)
    controller: SaturatedController = field(default_factory=SaturatedController)
    exploration: Exploration = field(default_factory=Exploration)
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    gate: Gate = field(default_factory=Gate)
    thresholds: Thresholds = field(default_factory=Thresholds)
    rate: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        in_range = self.rate * self.gate.deadline >= 2.0 and self.rate <= 1000.0
        expected = "at least two ticks in gate.deadline, and at most 1000 Hz"
        require(in_range, "rate", self.rate, expected)
        name, estimator = self.controller.features, self.estimator
        is_estimated = not self.features.needs_markers_jacobian or estimator.has_markers_jacobian
        expected = "'srd', or an estimator of the markers' motion, such as dlt or projection"
        require(is_estimated, "controller.features", name, expected)
        is_estimated = not self.features.needs_sizes or estimator.has_sizes_jacobian
        expected = "'srd' or 'points', or an estimator of how sizes change, such as affine"
        require(is_estimated, "controller.features", name, expected)

    @cached_property
    def guarded_estimator(self) -> Estimator:
        """Estimator that a step calls: a user-defined one in a guard."""
        return guard_estimator(self.estimator)

    @cached_property
    def period(self) -> int:
        """Time from tick to tick in ns."""
        return round(1e9 / self.rate)

    @cached_property
    def rcm(self) -> RcmStruct:
        """Mechanism with marker 1 as its point, for compiled functions."""
        return self.mechanism.to_struct(self.tool.offset)

    @cached_property
    def features(self) -> FeatureVector:
        """Feature vector that the controller acts on."""
        return FEATURE_VECTORS[self.controller.features]

    @cached_property
    def kernel(self) -> EstimatorKernel | None:
        """Compiled form of the estimator; None if it or the feature vector does not compile."""
        return None if self.features.code == INTERPRETED_CODE else find_kernel(self.estimator)

    @cached_property
    def parameters(self) -> Rows[KernelParameters]:
        """Settings of all parts in one row, for compiled functions."""
        estimator = self.estimator
        return to_row(
            KernelParameters(
                rcm=self.rcm,
                tool=self.tool.struct,
                controller=self.controller,
                features=self.features.parameters(self.controller.bounds),
                needs_markers_jacobian=self.features.needs_markers_jacobian,
                uses_paper_potential=self.controller.potential == "printed",
                imaged_rcm=self.imaged_rcm,
                uses_paper_rcm=self.imaged_rcm.printed,
                estimates_rcm=estimator.estimates_rcm,
                tolerates_lost_marker=estimator.tolerates_lost_marker and estimator.estimates_rcm,
                gate=self.gate,
                thresholds=self.thresholds,
                exploration=self.exploration,
                period=self.period,
            )
        )

    def position_of_marker_1(self, q: Floats) -> Floats:
        """Return the position p₁ (3,) of marker 1 in mm at the joints q (3,), eq. (2)."""
        return compute_position(self.rcm, q)

    def require_target(self, target: Target) -> None:
        """Raise `BadInput` if no motion to a target may begin.

        Its markers are possible and apart, its joints within their limits or all unknown (NaN), and
        it has the markers' sizes if the controller acts on them.
        """
        require_possible_markers("target.points", target.points)
        if not np.isnan(target.q).all():
            tolerance = self.thresholds.limit_tolerance
            require_joints_within_limits("target.q", target.q, self.mechanism, tolerance)
        self.require_sizes(target)

    def require_sizes(self, target: Target) -> None:
        """Raise `BadInput` if a target lacks the marker sizes that the controller needs."""
        is_complete = not self.features.needs_sizes or bool(np.isfinite(target.sizes).all())
        name = self.controller.features
        expected = f"taught with the markers' sizes, on which controller.features = {name!r} acts"
        require(is_complete, "target", "one without", expected)

    def init(self) -> State:
        """Return the state before the first observation: Ĵ = 0, drive off."""
        rest_command = CommandStruct.from_source(self.gate.rest())
        times = "gap_since", "contradicted_since", "mismatch_since", "camera_moved_at"
        never = dict.fromkeys(times, NEVER_NS)
        unknown = {
            "reference_error": np.inf,
            "pose_bound": np.nan,
            "bound_parts": np.nan,
            "blocked_joint": -1,
        }
        decision = Decision.of(command=rest_command, **unknown, **never)
        monitor, estimation = initial_monitor_state(), make_initial_estimation_rows()
        stored = StoredState.of(decision=decision, monitor=monitor, **estimation)
        return State(stored, self._initial_memory())

    def _initial_memory(self) -> EstimatorMemory | tuple[()]:
        """Return the memory of the estimator before the first frame."""
        if self.kernel is not None and self.kernel.estimates_rcm:
            return ()
        return EstimatorMemory(self.imaged_rcm.init()[0], self.guarded_estimator.init())

    def restart(self, state: State) -> State:
        """Return the state with which another run begins: drive off, at rest, estimate preserved.

        FAULT remains. The tool may have been moved by hand between the runs. If the camera was
        moved, the first frames of the new run show it.

        Parameters
        ----------
        state : State
            State after the earlier run.

        Returns
        -------
        State
            Initial state, with the estimate if exploration had ended.
        """
        mode = state.mode if state.phase is Phase.FAULT else Mode()
        mode_struct = ModeStruct.from_source(mode)
        rest_command = CommandStruct.from_source(self.gate.rest())
        decision = replace_fields(state.decision, mode=mode_struct, command=rest_command)
        estimate, memory = state.stored.estimate, state.memory
        parts: dict[str, Row] = {"decision": decision, "monitor": initial_monitor_state()}
        if state.explored:
            exploration = state.stored.exploration_state
            exploration = replace_fields(exploration, has_begun=False, has_no_room=False)
            parts["exploration_state"] = exploration
            parts["estimate"] = replace_fields(estimate, exposure=NEVER_NS)
        else:
            parts |= make_initial_estimation_rows()
            markers = {"points": estimate.points, "p1": estimate.p1}
            parts["estimate"] = replace_fields(parts["estimate"], **markers)
            memory = self._initial_memory()
        return State(replace_fields(state.stored, **parts), memory, state.target, mode.detail)

    def warm_up(self) -> None:
        """Compile every function that `step` calls, so that nothing compiles while an arm moves.

        The observations are made up. A user-defined estimator and the feature vector are checked
        first.

        Raises
        ------
        UnusableEstimator
            If a user-defined estimator fails or is not pure; the class is in
            `rcmservo.servo.user_estimator`.
        BadInput
            If the feature vector fails, or if its Jacobian is not its derivative.
        """
        check_estimator(self.estimator, self.tool)
        check_feature_vector(self.features)
        state, q = self.init(), np.mean(self.mechanism.limits.arrays, axis=0)
        points = np.array([[100.0, 50.0], [200.0, 100.0]])
        for k in range(WARM_UP_TICKS):
            observation = self._make_up_observation(k, q, points)
            state = self.step(state, observation, Target(points, q))
        passed = self.gate.admit(ZERO_RATES, state.command, q, self.rcm, state.command.time + 1)
        self.gate.stop(passed.command, passed.command.time + 1)
        reset_slowest(self.guarded_estimator)

    def _make_up_observation(self, k: int, q: Floats, points: Floats) -> Observation:
        """Return the k-th observation of a tool that turns a little from q (3,)."""
        now, q_k = (k + 1) * self.period, q + 1e-3 * k
        points_k = points + k * np.array([[0.5, -1.0], [1.0, -3.0]])
        return Observation(now, q_k, now, True, ZERO_RATES, k, now - 1, now, q_k, points_k)

    def step(
        self,
        state: State,
        observation: Observation,
        target: Target,
        request: Request = Request.NONE,
        jog: Floats = ZERO_RATES,
    ) -> State:
        """Make one tick, from the observation to the command.

        The checks compare the frame with the prediction of the projection fit and accept or reject
        it. The estimator updates o_c and Ĵ from an accepted frame. The controller predicts the
        error for the present joints and computes v and the joint rates. The checks collect the
        causes, the state machine chooses the mode, and the gate bounds the rates. These steps are
        the functions `step` and `conclude` of `rcmservo.servo.tick`. An estimator that does not
        compile runs in Python, once per frame.

        Parameters
        ----------
        state : State
            State after the previous tick. It does not change.
        observation : Observation
            Joints, and markers of the newest frame.
        target : Target
            Target of the motion.
        request : Request
            Request of the operator at this tick.
        jog : Floats
            Requested joint rates (3,) in rad/s, rad/s, mm/s if the request is JOG.

        Returns
        -------
        State
            State after this tick, with the command.

        Raises
        ------
        ValueError
            If `request` is not a member of `Request`.

        Notes
        -----
        Types and shapes of the arrays are not checked. A failure of a user-defined estimator or
        feature vector raises nothing; the notes of `Estimator` and `FeatureVector` state its
        result.
        """
        stored, is_new = copy_row(state.stored), target != state.target
        numbers, code = observation_numbers(observation), REQUESTS.index(request)
        setpoint = target.points, target.q, target.taught_at, is_new, code, jog
        kernel: Any = self.kernel
        rows, parameters, failure = stored.rows, self.parameters, ""
        if kernel is not None:
            tick = make_compiled_tick(cast(Any, type(kernel)))
            memory, cause_changed = tick(
                rows, state.memory, numbers, setpoint, tuple(kernel), parameters
            )
        else:
            line_memory, own_memory = cast(EstimatorMemory, state.memory)
            line_memory, frame_result, dt = begin_tick(
                rows, line_memory, numbers, setpoint, parameters
            )
            if frame_result == FRAME_UPDATES:
                own_memory, failure = self._update_estimate(
                    stored, own_memory, observation, target, dt
                )
            failure = failure or read_failure(own_memory)
            cast(Any, stored.estimator_result.rows)["has_failed"] = failure != ""
            was_reset = finish_tick(rows, frame_result, parameters)
            memory = EstimatorMemory(line_memory, own_memory)
            if was_reset:
                memory = self._initial_memory()
            cause_changed = stored.decision.mode.cause != state.decision.mode.cause
        next_state = State(stored, memory, target, state.detail)
        if not cause_changed:
            return next_state
        detail = failure or self._describe_cause(next_state, observation, state.monitor)
        return next_state._replace(detail=detail)

    def _update_estimate(
        self, stored: StoredState, memory: Any, observation: Observation, target: Target, dt: float
    ) -> tuple[Any, str]:
        """Update an estimator that does not compile by an accepted frame, dt s after the last one.

        A lost marker is replaced by the prediction of the projection fit. Return the memory of the
        estimator, and the failure message of the feature vector.
        """
        estimator, tool, estimate, failure = self.guarded_estimator, self.tool, stored.estimate, ""
        sample = Sample(estimate.p1, observation.points, estimate.o_c, dt, observation.sizes)
        memory = estimator.update(memory, tool, sample)
        points = estimator.filtered_markers(memory, tool, sample)
        is_detected = np.isfinite(observation.points)
        if not is_detected.all():
            predicted = filter_markers(stored.projection_fit.rows[0], estimate.p1, tool.struct)
            points = np.where(is_detected, points, predicted)
        imaged_rcm, numbers = estimator.imaged_rcm(memory), dict[str, Any]()
        if imaged_rcm is None:
            numbers["J_hat"] = estimator.jacobian(memory, tool, sample)
        else:
            numbers["o_c"], numbers["o_c_covariance"] = imaged_rcm
        if imaged_rcm is not None or self.features.needs_markers_jacobian:
            numbers["markers_jacobian"] = estimator.markers_jacobian(memory, tool, sample)
        result = EstimatorResult.of(points=points, has_imaged_rcm=imaged_rcm is not None, **numbers)
        cast(Any, stored.rows)["estimator_result"] = result.rows
        if self.features.code == INTERPRETED_CODE:
            failure = self._measure_features(stored, memory, sample, target)
        return memory, failure

    def _measure_features(
        self, stored: StoredState, memory: Any, sample: Sample, target: Target
    ) -> str:
        """Measure a feature vector that does not compile and return its failure message."""
        estimate, result = stored.estimate, stored.estimator_result
        points, motion = result.points.copy(), result.markers_jacobian
        o_c = (result.o_c if result.has_imaged_rcm else estimate.o_c).copy()
        if self.features.ignores_lost_markers:
            points[~np.isfinite(sample.points)] = np.nan
        if self.features.needs_sizes:
            sizes_jacobian = self.guarded_estimator.sizes_jacobian(memory, self.tool, sample)
            motion = np.vstack([motion, sizes_jacobian])
        markers = MarkerPair(points, sample.sizes.copy(), o_c)
        desired = MarkerPair(stored.decision.aim.copy(), target.sizes, o_c)
        error, jacobian, failure = linearise(self.features, markers, desired, motion)
        n = len(error)
        estimate.controlled_error[:n], estimate.controlled_jacobian[:n] = error, jacobian
        return failure

    def _describe_cause(self, state: State, observation: Observation, before: MonitorState) -> str:
        """Return the details of a new cause, such as the joint concerned.

        `before` is the state of the checks before the tick, as a cause may reset it.
        """
        assert state.target is not None
        facts = DetailFacts(
            observation,
            state.monitor,
            self.mechanism,
            self.thresholds,
            state.target.points,
            state.stored.workspace.target.markers,
            self.exploration,
            state.stored.exploration_state.disagreement,
            self.estimator.advice,
            state.stored.exploration_state,
        )
        details = [state.cause.declared.detail(facts)]
        if state.cause in EXPLAINED_BY_MOTION:
            details.append(state.target.swing_text)
        if state.cause in EXPLAINED_BY_ARM:
            details.append(describe_arm_error(before))
        if state.cause in EXPLAINED_BY_REPORTS:
            details.append(describe_slow_reports(before))
        return "; ".join(text for text in details if text)
