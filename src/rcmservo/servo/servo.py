"""The servo: features, imaged RCM, estimate, law and gate composed into one pure step.

No clock, no input, no output: the same state and observation always give the same answer. A step
looks (what a new frame teaches), plans (the velocity wanted of marker 1), asks what is wrong
(faults.py) and what follows from that (states.py), and sends what is left through the gate.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from rcmservo.errors import require
from rcmservo.guard.faults import (
    DISAGREEMENTS,
    FASTEST,
    Thresholds,
    Watch,
    arm_faults,
    begin,
    camera_faults,
    finite,
    leapt,
    loop_faults,
    lost,
    misplaced,
    stays,
    unwatched,
    watch_estimate,
    watch_frame,
    watch_loop,
    watch_markers,
)
from rcmservo.guard.gate import Gate
from rcmservo.guard.states import Action, Cause, Mode, Phase, Request, Signs, gravest, transition
from rcmservo.interfaces import Command, Floats, Observation, Target
from rcmservo.method.controller import SaturatedController, control, scaled
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.exploration import Exploration, Exploring
from rcmservo.method.features import SCALE, difference, measured
from rcmservo.method.imaged_rcm import ImagedRcm, follow
from rcmservo.method.kinematics import Kinematics, blocked, joint_rates, position
from rcmservo.method.tool import Tool
from rcmservo.servo.own_estimator import examine, failure, learner

STALL_TIME = 6.0
STALL_GAINS = 3.0
STALL_FALL = 0.2
STALL_SHARE = 0.02
STALL_ERROR = 0.5
"""A scaled error √(2V) above STALL_ERROR that has not fallen by STALL_FALL, or by STALL_SHARE of
itself, in STALL_TIME s and in STALL_GAINS/k has stalled."""

LIMIT_HORIZON = 0.1
LIMIT_SHARE = 0.3
"""A joint that would pass its limit within LIMIT_HORIZON s blocks the way if less than LIMIT_SHARE
of the speed is left without it."""

COMPARABLE = 10.0
"""mm from one frame to the next up to which the markers' motion is foretold; by hand a tool moves
further."""

LIMIT_CAUSES = (Cause.JOINT_1_LIMIT, Cause.JOINT_2_LIMIT, Cause.JOINT_3_LIMIT)

UNLEARNT = {
    Cause.DIVERGED,
    Cause.NOT_EXPLORED,
    Cause.ESTIMATE_LARGE,
    Cause.ESTIMATE_NOT_FINITE,
    Cause.ESTIMATOR_FAILED,
    Cause.NOT_FINITE,
}
"""Causes of a pause or fault after which the estimate is learnt anew, beside a camera that was
moved.

After the others it is kept, and with it the newest frame believed, so that a camera moved meanwhile
is noticed.
"""


@dataclass(frozen=True, eq=False)
class State:
    """All that the servo remembers, and what it decided at the last tick.

    ``mode`` holds its phase and cause, ``watch`` what the checks for faults remember. ``frame`` is
    the newest seen and ``believed`` the newest accepted (-1: none), which showed ``points`` (2, 2)
    px with marker 1 at ``p1`` (3,) mm. ``o_c`` (2,) px and ``rcm_condition`` of eq. (16);
    ``exposure`` ns that of the newest frame learnt from; ``J_hat`` (3, 3) and its scaled
    ``condition``; ``y`` and ``delta`` = Δy (3,) at that exposure; ``ahead`` (3,) the error as
    predicted for now; ``v`` (3,) mm/s wanted of marker 1; ``command`` as the gate passed it;
    ``moved``, when the camera was last noticed to have been moved (ns, -1: never); ``peak`` the
    error √(2V) to the ``target`` that has last been fallen short of, at ``peak_time`` ns. NaN where
    not known yet.
    """

    mode: Mode
    command: Command
    watch: Watch
    frame: int
    believed: int
    exposure: int
    points: Floats
    lines: Floats
    line_count: int
    o_c: Floats
    rcm_condition: float
    memory: Any
    tour: Exploring | None
    no_room: bool
    explored: bool
    p1: Floats
    J_hat: Floats
    condition: float
    y: Floats
    delta: Floats
    ahead: Floats
    v: Floats
    blocked: int
    target: Target | None
    moved: int
    peak: float
    peak_time: int
    failure: str = ""
    """What a user's own estimator did wrong last, until its fault is cleared."""

    @property
    def phase(self) -> Phase:
        """What the servo is doing."""
        return self.mode.phase

    @property
    def cause(self) -> Cause:
        """Why it is not simply on its way."""
        return self.mode.cause

    @property
    def words(self) -> str:
        """Phase, cause and way out in words, and what an estimator did wrong."""
        own = self.cause is Cause.ESTIMATOR_FAILED
        return f"{self.mode.words}: {self.failure}" if own else self.mode.words

    def but(self, **changes: Any) -> "State":
        """The same state with some fields changed: dataclasses.replace, without its cost in every
        tick."""
        state = object.__new__(State)
        state.__dict__.update(self.__dict__, **changes)
        return state


@dataclass(frozen=True)
class Servo:
    """The paper's block diagram. What the robot knows of itself, and a choice for every box.

    ``rate`` is the number of ticks a second that it is stepped at.
    """

    mechanism: Kinematics
    tool: Tool
    estimator: Estimator = field(default_factory=ProjectionEstimator)
    controller: SaturatedController = field(default_factory=SaturatedController)
    exploration: Exploration = field(default_factory=Exploration)
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    gate: Gate = field(default_factory=Gate)
    thresholds: Thresholds = field(default_factory=Thresholds)
    rate: float = 100.0

    WARM_UP: ClassVar[int] = 8

    def __post_init__(self) -> None:
        good = self.rate * self.gate.deadline >= 2.0 and self.rate <= 1000.0
        require(good, "rate", self.rate, "at least two ticks in gate.deadline, and at most 1000 Hz")

    @cached_property
    def learner(self) -> Estimator:
        """The estimator as a step calls it: a user's own through a guard."""
        return learner(self.estimator)

    @cached_property
    def period(self) -> int:
        """ns from tick to tick."""
        return round(1e9 / self.rate)

    @cached_property
    def zero(self) -> float:
        """ρ of marker 1 (mm) where the insertion joint reads zero."""
        return self.mechanism.insertion_zero + self.tool.offset

    def marker_1(self, q: Floats) -> Floats:
        """p₁ (3,) mm at the joints q (3,)."""
        return position(self.mechanism.kind, self.zero, q)

    def init(self) -> State:
        """Nothing seen, nothing known: Ĵ = 0, drive off."""
        return State(
            mode=Mode(),
            command=self.gate.rest(),
            watch=begin(),
            frame=-1,
            believed=-1,
            **self._nothing_learnt(),
            v=np.zeros(3),
            blocked=-1,
            target=None,
            moved=-1,
            peak=np.inf,
            peak_time=0,
        )

    def _nothing_learnt(self) -> dict[str, Any]:
        """The part of a state that frames teach, before the first."""
        lines, count = self.imaged_rcm.init()
        return {
            "exposure": -1,
            "points": np.full((2, 2), np.nan),
            "lines": lines,
            "line_count": count,
            "o_c": np.full(2, np.nan),
            "rcm_condition": np.inf,
            "memory": self.learner.init(),
            "tour": None,
            "no_room": False,
            "explored": False,
            "p1": np.full(3, np.nan),
            "J_hat": np.zeros((3, 3)),
            "condition": np.inf,
            "y": np.full(3, np.nan),
            "delta": np.full(3, np.nan),
            "ahead": np.full(3, np.nan),
        }

    def again(self, state: State) -> State:
        """The state to begin another run with: drive off, at rest, with what was learnt. A fault
        stays one.

        The tool may have been moved by hand since, but if the camera was, nothing but a new look
        can tell.
        """
        mode = state.mode if state.phase is Phase.FAULT else Mode()
        state = state if state.explored else self._unlearnt(state)
        unseen = {"frame": -1, "believed": -1, "exposure": -1, "watch": begin()}
        return state.but(mode=mode, command=self.gate.rest(), tour=None, no_room=False, **unseen)

    def _unlearnt(self, state: State) -> State:
        """The state without what was learnt, but for where the markers were seen last."""
        return state.but(**self._nothing_learnt() | {"points": state.points, "p1": state.p1})

    def warm_up(self) -> None:
        """Compile all that `step` calls, on made-up observations, so that nothing compiles while an
        arm moves. A user's own estimator is tried first, and refused if it fails."""
        examine(self.estimator, self.tool)
        state = self.init()
        q = (np.array(self.mechanism.limits.lower) + np.array(self.mechanism.limits.upper)) / 2.0
        points = np.array([[100.0, 50.0], [200.0, 100.0]])
        target = Target(points, q)
        for k in range(self.WARM_UP):
            turned = points + k * np.array([[0.5, -1.0], [1.0, -3.0]])
            now = (k + 1) * self.period
            at = q + 1e-3 * k
            seen = Observation(now, at, now, True, np.zeros(3), k, now - 1, now, at, turned)
            state = self.step(state, seen, target)
            if state.tour is not None:
                tour = self.exploration.visit(state.tour, state.p1, turned)
                self.exploration.complete(
                    tour._replace(visits=4 * self.exploration.rounds), state.J_hat, state.o_c
                )
            if k > self.WARM_UP // 2:
                state = state.but(mode=Mode(Phase.SERVO), explored=True, J_hat=np.diag(SCALE))
        leapt(points, points, q, 1.0)
        misplaced(points, points, state.o_c, state.y, state.J_hat, q, 1.0)
        watch_estimate(state.watch._replace(p1=q, points=points), q, points, state.o_c, state.J_hat)

    def step(
        self, state: State, seen: Observation, target: Target, request: Request = Request.NONE
    ) -> State:
        """One tick: learn from the frame if it is new, decide, and pass the decision through the
        gate.

        ``request`` is what a person asks for at this tick.
        """
        if target is not state.target:
            state = state.but(target=target, peak=np.inf, peak_time=seen.now)
        state = state.but(watch=watch_loop(state.watch, state.command, seen, self.period))
        new = seen.frame > state.frame
        if new:
            state = self._look(state, seen, target)
        accepted = new and state.believed == seen.frame
        state = self._plan(state, seen, accepted)
        signs = Signs(seen.enabled, state.believed >= 0, accepted, state.explored)
        causes = list(self._causes(state, seen, target))
        state = self._enter(
            state,
            transition(state.mode, causes, signs, request, seen.now),
            gravest(causes),
            seen.now,
        )
        return self._send(state, seen)

    def _look(self, state: State, seen: Observation, target: Target) -> State:
        """What a new frame teaches, unless it shows no tool's motion: the imaged RCM, Ĵ, and the
        error."""
        state = state.but(watch=watch_frame(state.watch, seen, self.thresholds), frame=seen.frame)
        p1 = self.marker_1(seen.q_exposure)
        if any(lost(seen.points)) or not finite(p1):
            return state
        state = self._believe(state, p1, seen)
        if state.believed != seen.frame:
            return state
        lines, count, o_c, rcm_condition = follow(
            state.lines, state.line_count, seen.points, self.imaged_rcm.refinements
        )
        state = state.but(
            points=seen.points,
            p1=p1,
            lines=lines,
            line_count=count,
            o_c=o_c,
            rcm_condition=rcm_condition,
        )
        return self._learn(state, seen, target) if self._rcm_known(state) else state

    def _rcm_known(self, state: State) -> bool:
        return state.rcm_condition <= self.imaged_rcm.max_condition

    def _believe(self, state: State, p1: Floats, seen: Observation) -> State:
        """Accept a frame, or reject it because its markers are not where the tool's motion puts
        them."""
        jump, way = self.thresholds.jump, p1 - state.p1
        if not math.hypot(*way) < COMPARABLE:
            wrong = False, False, False
        elif state.explored and self._rcm_known(state):
            wrong = misplaced(seen.points, state.points, state.o_c, state.y, state.J_hat, way, jump)
        else:
            wrong = leapt(seen.points, state.points, way, jump)
            if state.watch.jumped and stays(state.watch, seen.points, jump):
                wrong = True, True, wrong[2]
        watch = watch_markers(state.watch, *wrong, seen.points, jump)
        return (
            state.but(watch=watch)
            if watch.rejected
            else state.but(watch=watch, believed=seen.frame)
        )

    def _learn(self, state: State, seen: Observation, target: Target) -> State:
        dt = (seen.exposure - state.exposure) * 1e-9 if state.exposure >= 0 else 0.0
        sample = Sample(state.p1, seen.points, state.o_c, dt)
        memory = self.learner.update(state.memory, self.tool, sample)
        J_hat = self.learner.jacobian(memory, self.tool, sample)
        before = state.failure if state.phase is Phase.FAULT else ""
        y, delta = measured(seen.points, target.points, state.o_c)
        watch = state.watch
        if state.explored:
            watch = watch_estimate(watch, state.p1, seen.points, state.o_c, J_hat)
        return state.but(
            exposure=seen.exposure,
            memory=memory,
            J_hat=J_hat,
            y=y,
            delta=delta,
            watch=watch,
            failure=failure(memory) or before,
        )

    def _plan(self, state: State, seen: Observation, accepted: bool) -> State:
        """The velocity wanted of marker 1: that of exploration, or of the law once there is an
        estimate."""
        if state.explored:
            return self._servo(state, seen)
        if state.phase is not Phase.ACQUIRE or state.no_room:
            return state.but(v=np.zeros(3))
        if state.tour is None:
            tour = self.exploration.begin(self.mechanism, self.zero, seen.q, seen.now)
            return state.but(tour=tour, no_room=tour is None)
        return self._explore(state, state.tour, seen, accepted)

    def _explore(self, state: State, tour: Exploring, seen: Observation, accepted: bool) -> State:
        p1 = self.marker_1(seen.q)
        if accepted and self.exploration.arrived(tour, p1):
            tour = self.exploration.visit(tour, state.p1, seen.points)
            if self.exploration.complete(tour, state.J_hat, state.o_c):
                return self._servo(state.but(tour=tour, explored=True), seen)
        return state.but(tour=tour, v=self.exploration.velocity(tour, p1))

    def _servo(self, state: State, seen: Observation) -> State:
        """The law, on the error as the joints' motion since the exposure has changed it: Δy + Ĵ
        (p₁(now) − p₁)."""
        ahead = difference(state.delta, -state.J_hat @ (self.marker_1(seen.q) - state.p1))
        law, limits = self.controller, self.mechanism.limits.arrays
        v, condition, error = control(
            state.J_hat,
            ahead,
            law.b,
            law.potential == "printed",
            law.gain,
            law.max_condition,
            law.max_speed,
        )
        peak, peak_time = max(state.peak, error), state.peak_time
        if error < peak - min(STALL_FALL, STALL_SHARE * peak) or state.phase is not Phase.SERVO:
            peak, peak_time = error, seen.now
        joint = blocked(
            self.mechanism.kind,
            self.zero,
            seen.q,
            v,
            *limits,
            self.gate.fastest,
            LIMIT_HORIZON,
            LIMIT_SHARE,
        )
        return state.but(
            ahead=ahead, v=v, condition=condition, blocked=joint, peak=peak, peak_time=peak_time
        )

    def _causes(self, state: State, seen: Observation, target: Target) -> Iterator[Cause]:
        """All that is wrong at this tick."""
        on = state.phase not in (Phase.DISABLED, Phase.FAULT)
        yield from arm_faults(state.watch, seen, on, *self.mechanism.limits.arrays, self.thresholds)
        yield from loop_faults(state.watch, seen, self.period, self.thresholds)
        yield from camera_faults(state.watch, seen, self.thresholds)
        if target.shown < state.moved:
            yield Cause.TARGET_OLD
        if not finite(state.J_hat.ravel()):
            yield Cause.ESTIMATOR_FAILED if state.failure else Cause.ESTIMATE_NOT_FINITE
        yield from (
            self._servo_causes(state, seen) if state.explored else self._tour_causes(state, seen)
        )

    def _tour_causes(self, state: State, seen: Observation) -> Iterator[Cause]:
        if state.no_room:
            yield Cause.NO_ROOM
        elif state.tour is not None and self.exploration.overdue(state.tour, seen.now):
            yield Cause.SWAPPED if self._out_of_order(state) else Cause.NOT_EXPLORED

    def _out_of_order(self, state: State) -> bool:
        """Whether marker 1 stands beyond marker 2 as seen from o_c, though its tool has it nearer
        the RCM."""
        first, second = state.points - state.o_c
        beyond = float(first @ second) > float(second @ second)
        return beyond and float(state.p1 @ (self.tool.second_marker(state.p1) - state.p1)) > 0.0

    def _servo_causes(self, state: State, seen: Observation) -> Iterator[Cause]:
        if not self._rcm_known(state):
            yield Cause.RCM_UNKNOWN
        if not np.abs(scaled(state.J_hat)).max() <= FASTEST:
            yield Cause.ESTIMATE_LARGE
        if not state.condition < self.controller.max_condition:
            yield Cause.SINGULAR
        elif not state.condition < 0.5 * self.controller.max_condition:
            yield Cause.NEARLY_SINGULAR
        if state.blocked >= 0:
            yield LIMIT_CAUSES[state.blocked]
        if state.watch.wrong >= DISAGREEMENTS:
            yield Cause.DIVERGED
        patience = max(STALL_TIME, STALL_GAINS / self.controller.gain)
        if state.peak > STALL_ERROR and seen.now - state.peak_time > patience * 1e9:
            yield Cause.STALLED

    def _enter(self, state: State, mode: Mode, cause: Cause, now: int) -> State:
        """The state in its new mode. A pause or fault forgets what it must not go on with."""
        entered = mode.phase is not state.phase
        if mode.phase in (Phase.PAUSED, Phase.FAULT) and (entered or cause.action is Action.PAUSE):
            state = self._without_filters(
                state, cause if cause.action >= Action.PAUSE else mode.cause, now
            )
        if mode.phase is Phase.ACQUIRE and state.phase is Phase.PAUSED and not state.explored:
            state = self._unlearnt(state)
        return state.but(mode=mode, peak=np.inf, peak_time=now) if entered else state.but(mode=mode)

    def _without_filters(self, state: State, cause: Cause, now: int) -> State:
        """The state with its counts begun anew, and without the estimate if the cause spoils it.

        Without an estimate nobody can tell one false marker from a camera that was moved: then it
        counts as that. Nor can anybody tell whether markers that changed places are wrong now or
        were before.
        """
        moved = cause is Cause.CAMERA_MOVED or (cause is Cause.SURPRISED and not state.explored)
        spoilt = moved or cause in UNLEARNT or (cause is Cause.SWAPPED and not state.explored)
        watch = unwatched(state.watch, spoilt)
        state = state.but(watch=watch, peak=np.inf, tour=None, no_room=False)
        if moved:
            state = state.but(moved=now)
        return state.but(believed=-1, **self._nothing_learnt()) if spoilt else state

    def _send(self, state: State, seen: Observation) -> State:
        """Through the gate, at the share of the speed that the mode allows; what is not finite
        there is a fault."""
        share = state.mode.share
        if not share > 0.0:
            state = state.but(v=np.zeros(3))
        if state.phase in (Phase.FAULT, Phase.DISABLED):
            return state.but(command=self.gate.stop(state.command, seen.now))
        rates = joint_rates(self.mechanism.kind, self.zero, seen.q, state.v)
        passed = self.gate.admit(
            rates, state.command, seen.q, self.mechanism.limits, seen.now, share
        )
        if passed.finite:
            return state.but(command=passed.command)
        mode = Mode(Phase.FAULT, Cause.NOT_FINITE, seen.now, asks=Action.FAULT)
        return self._enter(state, mode, Cause.NOT_FINITE, seen.now).but(
            command=self.gate.stop(state.command, seen.now)
        )
