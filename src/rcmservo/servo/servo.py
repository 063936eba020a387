"""The servo: features, imaged RCM, estimate, law and gate composed into one pure step.

No clock, no input, no output: the same state and observation always give the same answer. What
can be compiled of a step is one function in tick.py.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, cast

import numpy as np

from rcmservo.constraints import Checked
from rcmservo.control.exploration import Exploration
from rcmservo.control.feature_vectors import FeatureVector, MarkerPair
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.errors import require
from rcmservo.estimation.base import Estimated, Estimator, EstimatorKernel, Sample
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.projection_prediction import located
from rcmservo.geometry.features import INTERPRETED
from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.geometry.kinematics import Kinematics, Rcm, position
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats, Observation, Target, observed_numbers
from rcmservo.numerics.structs import Rows, as_row, changed, copied
from rcmservo.safety.checks.facts import DetailFacts
from rcmservo.safety.gate import CommandStruct, Gate
from rcmservo.safety.monitor_state import begin
from rcmservo.safety.state_machine import REQUESTS, Mode, ModeStruct, Phase, Request
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.kernel_parameters import KernelParameters
from rcmservo.servo.state import Decision, EstimatorMemory, State, Stored, ignorance
from rcmservo.servo.tick import begin_tick, finish_tick, tick_of
from rcmservo.servo.update_estimate import LEARN
from rcmservo.servo.user_estimator import examine, failure_of, kernel_of, learner, time_anew
from rcmservo.servo.user_features import examine_features, linearise

STILL = np.zeros(3)
WARM_UP = 8


@dataclass(frozen=True)
class Servo(Checked):
    """The paper's block diagram. What the robot knows of itself, and a choice for every box.

    Parameters
    ----------
    mechanism : Kinematics
        The arm's kinematics.
    tool : Tool
        Where the markers are on the tool.
    estimator : Estimator
        How Ĵ is learnt.
    controller : SaturatedController
        The law.
    exploration : Exploration
        The first motion, from nothing.
    imaged_rcm : ImagedRcm
        How the imaged RCM is computed.
    gate : Gate
        Bounds on every command.
    thresholds : Thresholds
        From where on something is a fault.
    rate : float
        Number of ticks a second that it is stepped at.
    """

    mechanism: Kinematics
    tool: Tool
    estimator: Estimator = field(default_factory=DltEstimator)
    controller: SaturatedController = field(default_factory=SaturatedController)
    exploration: Exploration = field(default_factory=Exploration)
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    gate: Gate = field(default_factory=Gate)
    thresholds: Thresholds = field(default_factory=Thresholds)
    rate: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        good = self.rate * self.gate.deadline >= 2.0 and self.rate <= 1000.0
        right = "at least two ticks in gate.deadline, and at most 1000 Hz"
        require(good, "rate", self.rate, right)
        features, estimator = self.controller.features, self.estimator
        needs = self.controller.feature_vector
        known = not needs.needs_motion or estimator.tells_motion
        right = "'srd', or an estimator that tells the markers' motion, such as dlt or projection"
        require(known, "controller.features", features, right)
        known = not needs.needs_sizes or estimator.tells_size_motion
        right = "'srd' or 'points', or an estimator that tells how sizes change, such as affine"
        require(known, "controller.features", features, right)

    @cached_property
    def learner(self) -> Estimator:
        """The estimator as a step calls it: a user's own through a guard."""
        return learner(self.estimator)

    @cached_property
    def period(self) -> int:
        """Ns from tick to tick."""
        return round(1e9 / self.rate)

    @cached_property
    def rcm(self) -> Rcm:
        """The mechanism and marker 1, as compiled functions know them."""
        return self.mechanism.rcm(self.tool.offset)

    @cached_property
    def features(self) -> FeatureVector:
        """Feature vector that the law acts on."""
        return self.controller.feature_vector

    @cached_property
    def kernel(self) -> EstimatorKernel | None:
        """Compiled form of the estimator; None where it or the feature vector does not compile."""
        return None if self.features.code == INTERPRETED else kernel_of(self.estimator)

    @cached_property
    def parameters(self) -> Rows[KernelParameters]:
        """Settings as the compiled functions take them."""
        return as_row(
            KernelParameters(
                rcm=self.rcm,
                tool=self.tool.shaft,
                controller=self.controller,
                features=self.features.parameters(self.controller.bounds),
                needs_motion=self.features.needs_motion,
                printed_potential=self.controller.potential == "printed",
                imaged_rcm=self.imaged_rcm,
                printed_rcm=self.imaged_rcm.printed,
                places_rcm=self.estimator.places_rcm,
                spares_marker=self.estimator.spares_marker and self.estimator.places_rcm,
                gate=self.gate,
                thresholds=self.thresholds,
                exploration=self.exploration,
                period=self.period,
            )
        )

    def marker_1(self, q: Floats) -> Floats:
        """p₁ (3,) mm at the joints q (3,)."""
        return position(self.rcm, q)

    def demand(self, target: Target) -> None:
        """BadInput for a target that does not tell what the law acts on."""
        known = not self.features.needs_sizes or bool(np.isfinite(target.sizes).all())
        name = self.controller.features
        right = f"shown with the markers' sizes, on which controller.features = {name!r} acts"
        require(known, "target", "one without", right)

    def init(self) -> State:
        """Nothing seen, nothing known: Ĵ = 0, drive off."""
        rest = CommandStruct.from_source(self.gate.rest())
        decision = Decision.of(command=rest, blocked=-1, astray=-1, peak=np.inf, moved=-1)
        stored = Stored.of(decision=decision, watch=begin(), **ignorance())
        return State(stored, self._nothing())

    def _nothing(self) -> EstimatorMemory | tuple[()]:
        """The estimator's memory while nothing is known."""
        if self.kernel is not None and self.kernel.places_rcm:
            return ()
        return EstimatorMemory(self.imaged_rcm.init()[0], self.learner.init())

    def again(self, state: State) -> State:
        """The state to begin another run with: drive off, at rest, with what was learnt. A fault
        stays one.

        The tool may have been moved by hand since, but if the camera was, nothing but a new look
        can tell.
        """
        mode = state.mode if state.phase is Phase.FAULT else Mode()
        rest = CommandStruct.from_source(self.gate.rest())
        decision = changed(state.decision, mode=ModeStruct.from_source(mode), command=rest)
        parts, memory, places = ignorance(), state.memory, state.stored.estimate
        if state.explored:
            tour = changed(state.stored.tour, begun=False, no_room=False)
            parts = {"estimate": changed(places, exposure=-1), "tour": tour}
        else:
            known = {"points": places.points, "p1": places.p1}
            parts["estimate"], memory = changed(parts["estimate"], **known), self._nothing()
        stored = changed(state.stored, decision=decision, watch=begin(), **parts)
        return State(stored, memory, state.target, mode.detail)

    def warm_up(self) -> None:
        """Compile all that `step` calls, on made-up observations, so that nothing compiles while an
        arm moves. Estimator and feature vector are tried first, and refused if they fail.
        """
        examine(self.estimator, self.tool)
        examine_features(self.features)
        state, q = self.init(), np.mean(self.mechanism.limits.arrays, axis=0)
        points = np.array([[100.0, 50.0], [200.0, 100.0]])
        for k in range(WARM_UP):
            state = self.step(state, self._made_up(k, q, points), Target(points, q))
        passed = self.gate.admit(STILL, state.command, q, self.rcm, state.command.time + 1)
        self.gate.stop(passed.command, passed.command.time + 1)
        time_anew(self.learner)

    def _made_up(self, k: int, q: Floats, points: Floats) -> Observation:
        """The k-th observation of a tool that turns a little."""
        now, at = (k + 1) * self.period, q + 1e-3 * k
        turned = points + k * np.array([[0.5, -1.0], [1.0, -3.0]])
        return Observation(now, at, now, True, np.zeros(3), k, now - 1, now, at, turned)

    def step(
        self,
        state: State,
        seen: Observation,
        target: Target,
        request: Request = Request.NONE,
        jog: Floats = STILL,
    ) -> State:
        """One tick, from the observation to the command in the state that is returned.

        The checks accept or reject the frame, the estimator updates o_c and Ĵ from an accepted one,
        and the controller, the checks, the state machine and the gate conclude (tick.py). Where the
        estimator compiles, all of it is one compiled function; where it does not, it is called in
        Python once per frame.

        Parameters
        ----------
        state : State
            State after the tick before.
        seen : Observation
            Joints, and markers of the newest frame.
        target : Target
            Markers to bring the tool to.
        request : Request
            Request of the operator at this tick.
        jog : array
            Joint rates (3,) rad/s, rad/s, mm/s, where that is to move them by hand.
        """
        stored, is_new = copied(state.stored), target is not state.target
        numbers, failure = observed_numbers(seen), ""
        setpoint = target.points, target.q, target.shown, is_new, REQUESTS.index(request), jog
        kernel: Any = self.kernel
        if kernel is not None:
            memory, changes = tick_of(cast(Any, type(kernel)))(
                stored.rows, state.memory, numbers, setpoint, tuple(kernel), self.parameters
            )
        else:
            lines, own = cast(EstimatorMemory, state.memory)
            rows, known = stored.rows, self.parameters
            lines, news, dt = begin_tick(rows, lines, numbers, setpoint, known)
            if news == LEARN:
                own, failure = self._estimate(stored, own, seen, target, dt)
            failure = failure or failure_of(own)
            cast(Any, stored.estimated.rows)["failed"] = failure != ""
            forgotten = finish_tick(rows, news, known)
            memory = self._nothing() if forgotten else EstimatorMemory(lines, own)
            changes = stored.decision.mode.cause != state.decision.mode.cause
        after = State(stored, memory, target, state.detail)
        return after._replace(detail=failure or self._detail(after, seen)) if changes else after

    def _estimate(
        self, stored: Stored, own: Any, seen: Observation, target: Target, dt: float
    ) -> tuple[Any, str]:
        """Update an estimator or feature vector that does not compile by an accepted frame, dt s
        after the one before; return its memory, and how the feature vector failed. A lost marker is
        where the fit of all frames has it.
        """
        learner, tool, e, failure = self.learner, self.tool, stored.estimate, ""
        sample = Sample(e.p1, seen.points, e.o_c, dt, seen.sizes)
        own = learner.update(own, tool, sample)
        points, is_seen = learner.located(own, tool, sample), np.isfinite(seen.points)
        if not is_seen.all():
            points = np.where(is_seen, points, located(stored.prospect.rows[0], e.p1, tool.shaft))
        placed, numbers = learner.imaged_rcm(own), dict[str, Any]()
        if placed is None:
            numbers["J_hat"] = learner.jacobian(own, tool, sample)
        else:
            numbers["o_c"], numbers["o_c_covariance"] = placed
        if placed is not None or self.features.needs_motion:
            numbers["motion"] = learner.motion(own, tool, sample)
        result = Estimated.of(points=points, placed=placed is not None, **numbers)
        cast(Any, stored.rows)["estimated"] = result.rows
        if self.features.code == INTERPRETED:
            failure = self._measure(stored, own, sample, target)
        return own, failure

    def _measure(self, stored: Stored, own: Any, sample: Sample, target: Target) -> str:
        """Measure a feature vector that does not compile; return how it failed."""
        e, result, sizes = stored.estimate, stored.estimated, sample.sizes.copy()
        points, motion = result.points.copy(), result.motion
        o_c = (result.o_c if result.placed else e.o_c).copy()
        if self.features.leaves_out_lost:
            points[~np.isfinite(sample.points)] = np.nan
        if self.features.needs_sizes:
            motion = np.vstack([motion, self.learner.size_motion(own, self.tool, sample)])
        aim = MarkerPair(target.points, target.sizes, o_c)
        markers = MarkerPair(points, sizes, o_c)
        error, jacobian, failure = linearise(self.features, markers, aim, motion)
        e.law_error[: len(error)], e.law_jacobian[: len(error)] = error, jacobian
        return failure

    def _detail(self, state: State, seen: Observation) -> str:
        """What a person should know of a cause that is new."""
        advice = self.estimator.advice
        facts = DetailFacts(seen, state.watch, self.mechanism, self.thresholds, advice)
        return state.cause.declared.detail(facts)
