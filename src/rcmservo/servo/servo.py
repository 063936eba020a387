"""The servo: features, imaged RCM, estimate, law and gate composed into one pure step.

No clock, no input, no output: the same state and observation always give the same answer. A step
looks (what a new frame shows), learns, plans (the velocity wanted of marker 1), asks what is wrong
and what follows from that (states.py), and sends what is left through the gate. What can be
compiled of it stands in core.py.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from rcmservo.errors import require
from rcmservo.guard.causes import Action, Cause, gravest_of
from rcmservo.guard.gate import Gate
from rcmservo.guard.states import Mode, Phase, Request, Signs, transition
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Told, Watch, begin, told, unwatched
from rcmservo.interfaces import Floats, Observation, Target
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.projection import ProjectionEstimator, ProjectionMemory
from rcmservo.method.exploration import Exploration
from rcmservo.method.features import SCALE
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.method.kinematics import Kinematics, Rcm, floats, joint_rates, position
from rcmservo.method.tool import Tool
from rcmservo.rows import Rows, as_row
from rcmservo.servo import core
from rcmservo.servo.diagnosis import detail, spoils, tour_faults
from rcmservo.servo.one_kernel import Fixed, Kept, tick
from rcmservo.servo.own_estimator import examine, failure, learner, time_anew
from rcmservo.servo.state import (
    Course,
    Estimate,
    Learnt,
    State,
    headed,
    ignorance,
    renewed,
    restarted,
)

STILL = np.zeros(3)
WARM_UP = 8


@dataclass(frozen=True)
class Servo:
    """The paper's block diagram. What the robot knows of itself, and a choice for every box."""

    mechanism: Kinematics
    """The arm's kinematics."""
    tool: Tool
    """Where the markers are on the tool."""
    estimator: Estimator = field(default_factory=ProjectionEstimator)
    """How Ĵ is learnt."""
    controller: SaturatedController = field(default_factory=SaturatedController)
    """The law."""
    exploration: Exploration = field(default_factory=Exploration)
    """The first motion, from nothing."""
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    """How the imaged RCM is computed."""
    gate: Gate = field(default_factory=Gate)
    """Bounds on every command."""
    thresholds: Thresholds = field(default_factory=Thresholds)
    """From where on something is a fault."""
    rate: float = 100.0
    """Number of ticks a second that it is stepped at."""

    def __post_init__(self) -> None:
        good = self.rate * self.gate.deadline >= 2.0 and self.rate <= 1000.0
        right = "at least two ticks in gate.deadline, and at most 1000 Hz"
        require(good, "rate", self.rate, right)

    @cached_property
    def learner(self) -> Estimator:
        """The estimator as a step calls it: a user's own through a guard."""
        return learner(self.estimator)

    @cached_property
    def period(self) -> int:
        """ns from tick to tick."""
        return round(1e9 / self.rate)

    @cached_property
    def rcm(self) -> Rcm:
        """The mechanism and marker 1, as compiled functions know them."""
        return self.mechanism.rcm(self.tool.offset)

    @cached_property
    def dials(self) -> Rows[core.Dials]:
        """What the compiled parts know of the boxes."""
        law, rcm = self.controller, self.rcm
        return core.Dials.of(
            kind=rcm.kind,
            zero=rcm.zero,
            lower=rcm.lower,
            upper=rcm.upper,
            fastest=floats(self.gate.speed),
            gain=law.gain,
            bounds=floats(law.bounds),
            printed=law.potential == "printed",
            max_condition=law.max_condition,
            max_speed=law.max_speed,
            refinements=self.imaged_rcm.refinements,
            rcm_printed=self.imaged_rcm.printed,
            rcm_condition=self.imaged_rcm.max_condition,
            period=self.period,
        ).rows

    @cached_property
    def threshold_row(self) -> Rows[Thresholds]:
        """The thresholds for the compiled parts."""
        return as_row(self.thresholds)

    @cached_property
    def fixed(self) -> Fixed | None:
        """What a tick in one compiled function needs; None where the estimator has no such
        function."""
        if type(self.estimator) is not ProjectionEstimator:
            return None
        return Fixed(self.dials, self.threshold_row, self.estimator.rule, self.tool.shaft)

    def marker_1(self, q: Floats) -> Floats:
        """p₁ (3,) mm at the joints q (3,)."""
        return position(self.rcm, q)

    def init(self) -> State:
        """Nothing seen, nothing known: Ĵ = 0, drive off."""
        course = Course.of(blocked=-1, peak=np.inf)
        return State(Mode(), self.gate.rest(), begin(), self._ignorance(), course)

    def _ignorance(self) -> Learnt:
        return ignorance(self.imaged_rcm.init()[0], self.learner.init())

    def _but_places(self, estimate: Estimate) -> Learnt:
        """Nothing learnt, but for where the markers were seen last."""
        learnt = self._ignorance()
        learnt.estimate.points[:], learnt.estimate.p1[:] = estimate.points, estimate.p1
        return learnt

    def again(self, state: State) -> State:
        """The state to begin another run with: drive off, at rest, with what was learnt. A fault
        stays one.

        The tool may have been moved by hand since, but if the camera was, nothing but a new look
        can tell.
        """
        mode = state.mode if state.phase is Phase.FAULT else Mode()
        learnt = state.learnt
        if not learnt.explored:
            learnt = self._but_places(learnt.estimate)
        estimate = renewed(learnt.estimate)
        learnt = learnt._replace(estimate=estimate, tour=None, no_room=False)
        return state.but(mode=mode, command=self.gate.rest(), watch=begin(), learnt=learnt)

    def warm_up(self) -> None:
        """Compile all that `step` calls, on made-up observations, so that nothing compiles while an
        arm moves. A user's own estimator is tried first, and refused if it fails."""
        examine(self.estimator, self.tool)
        state, q = self.init(), np.mean(self.mechanism.limits.arrays, axis=0)
        points = np.array([[100.0, 50.0], [200.0, 100.0]])
        target = Target(points, q)
        for k in range(WARM_UP):
            seen = self._made_up(k, q, points)
            state = self.step(state, seen, target)
            learnt = state.learnt
            if learnt.tour is not None:
                tour = self.exploration.visit(learnt.tour, state.p1, seen.points)
                toured = tour._replace(visits=4 * self.exploration.rounds)
                self.exploration.complete(toured, state.J_hat, state.o_c)
            if k > WARM_UP // 2:
                learnt.estimate.J_hat[:] = np.diag(SCALE)
                known = learnt._replace(explored=True)
                state = state.but(mode=Mode(Phase.SERVO), learnt=known)
        time_anew(self.learner)

    def _made_up(self, k: int, q: Floats, points: Floats) -> Observation:
        """The k-th observation of a tool that turns a little."""
        now, at = (k + 1) * self.period, q + 1e-3 * k
        turned = points + k * np.array([[0.5, -1.0], [1.0, -3.0]])
        return Observation(now, at, now, True, np.zeros(3), k, now - 1, now, at, turned)

    def step(
        self, state: State, seen: Observation, target: Target, request: Request = Request.NONE
    ) -> State:
        """One tick: learn from the frame if it is new, decide, and pass the decision through the
        gate.

        ``request`` is what a person asks for at this tick.
        """
        last, phase, now = state.command, state.mode.phase, seen.now
        numbers = told(seen, now - last.time if last.number > 0 else self.period)
        course = state.course if target is state.target else restarted(state.course, now)
        if state.explored and self.fixed is not None:
            watch, learnt, course, news, found = self._at_once(
                state, course, numbers, target, self.fixed
            )
        else:
            watch, learnt, news = self._look(state, seen, numbers, target)
            if not learnt.explored:
                learnt, course = self._explore(learnt, course, phase, seen, news)
            course, found = self._decide(watch, learnt, course, phase, numbers)
        accepted = news >= core.BELIEVED
        found |= self._more_faults(learnt, phase, numbers)
        if target.shown < state.moved:
            found |= Cause.TARGET_OLD.bit
        signs = Signs(seen.enabled, accepted or watch.believed >= 0, accepted, learnt.explored)
        mode = transition(state.mode, found, signs, request, now, self.thresholds)
        after = State(state.mode, last, watch, learnt, course, target, state.moved)
        return self._send(self._enter(after, mode, gravest_of(found), seen), seen)

    def _look(
        self, state: State, seen: Observation, numbers: Told, target: Target
    ) -> tuple[Watch, Learnt, int]:
        """What a tick shows: frame, imaged RCM, Ĵ and error; and what it brought."""
        learnt, explored, thresholds = state.learnt, state.learnt.explored, self.threshold_row
        before = learnt.estimate.rows
        watch, rows, lines, news, dt = core.look(
            state.watch.rows, before, learnt.lines, numbers, explored, self.dials, thresholds
        )
        estimate, memory = Estimate(rows), learnt.memory
        if news == core.LEARN:
            sample = Sample(estimate.p1, seen.points, estimate.o_c, dt)
            memory = self.learner.update(memory, self.tool, sample)
            J_hat = self.learner.jacobian(memory, self.tool, sample)
            core.learn(watch, rows, J_hat, target.points, seen.exposure, explored, thresholds)
        learnt = Learnt(estimate, lines, memory, learnt.tour, learnt.no_room, explored)
        return Watch(watch), learnt, news

    def _at_once(
        self, state: State, course: Course, numbers: Told, target: Target, fixed: Fixed
    ) -> tuple[Watch, Learnt, Course, int, int]:
        """What `_look` and `_decide` give, by one compiled function."""
        learnt = state.learnt
        before = Kept(
            state.watch.rows, learnt.estimate.rows, learnt.lines, learnt.memory, course.rows
        )
        situation = self._situation(state.phase, True)
        kept, news, found = tick(before, numbers, situation, target.points, fixed)
        watch, estimate, lines, memory, rows = kept
        learnt = learnt._replace(
            estimate=Estimate(estimate), lines=lines, memory=ProjectionMemory(*memory)
        )
        return Watch(watch), learnt, Course(rows), news, found

    def _explore(
        self, learnt: Learnt, course: Course, phase: Phase, seen: Observation, news: int
    ) -> tuple[Learnt, Course]:
        """The first motion: on the tour, until Ĵ predicts what was seen there."""
        if phase is not Phase.ACQUIRE or learnt.no_room:
            return learnt, headed(course, STILL, STILL)
        if learnt.tour is None:
            room = self.thresholds.least_room
            tour = self.exploration.begin(self.rcm, seen.q, seen.now, room)
            return learnt._replace(tour=tour, no_room=tour is None), course
        p1, tour, estimate = self.marker_1(seen.q), learnt.tour, learnt.estimate
        if news >= core.BELIEVED and self.exploration.arrived(tour, p1):
            tour = self.exploration.visit(tour, estimate.p1, estimate.points)
            if self.exploration.complete(tour, estimate.J_hat, estimate.o_c):
                return learnt._replace(tour=tour, explored=True), course
        v = self.exploration.velocity(tour, p1)
        return learnt._replace(tour=tour), headed(course, v, joint_rates(self.rcm, seen.q, v))

    def _decide(
        self, watch: Watch, learnt: Learnt, course: Course, phase: Phase, numbers: Told
    ) -> tuple[Course, int]:
        """The velocity wanted of marker 1 by the law, and what is wrong at this tick."""
        rows, found = core.decide(
            watch.rows, learnt.estimate.rows, course.rows, numbers,
            self._situation(phase, learnt.explored), self.dials, self.threshold_row,
        )  # fmt: skip
        return Course(rows), found

    def _situation(self, phase: Phase, explored: bool) -> core.Situation:
        on = phase is not Phase.DISABLED and phase is not Phase.FAULT
        return core.Situation(on, explored, phase is Phase.SERVO)

    def _more_faults(self, learnt: Learnt, phase: Phase, numbers: Told) -> int:
        """What is wrong beside that: things that no compiled function knows of."""
        found = 0
        if phase is Phase.PAUSED and numbers.frame < 0:
            found |= Cause.STALE.bit  # nothing was seen that it could go on from
        if failure(learnt.memory):
            found |= Cause.ESTIMATOR_FAILED.bit
        if not learnt.explored:
            found |= tour_faults(learnt, self.exploration, self.tool, numbers.now)
        return found

    def _enter(self, state: State, mode: Mode, cause: Cause, seen: Observation) -> State:
        """The state in its new mode. A pause or fault forgets what it must not go on with."""
        before, now, memory = state.mode, seen.now, state.learnt.memory
        entered = mode.phase is not before.phase
        if mode.phase in (Phase.PAUSED, Phase.FAULT) and (entered or cause.action is Action.PAUSE):
            why = cause if cause.action >= Action.PAUSE else mode.cause
            state = self._without_filters(state, why, now)
        if mode.phase is Phase.ACQUIRE and before.phase is Phase.PAUSED and not state.explored:
            state = state.but(learnt=self._but_places(state.learnt.estimate))
        if mode.cause is not before.cause:
            words = detail(mode.cause, state.watch, seen, self.mechanism, self.thresholds)
            words = words or failure(memory)
            if mode.cause is Cause.NOT_EXPLORED:
                words = self.estimator.advice
            mode = replace(mode, detail=words) if words else mode
        course = restarted(state.course, now) if entered else None
        return state.but(mode=mode, course=course) if mode is not before else state

    def _without_filters(self, state: State, cause: Cause, now: int) -> State:
        """The state with its counts begun anew, and without the estimate if the cause spoils it."""
        moved, spoilt = spoils(cause, state.explored)
        learnt = self._ignorance() if spoilt else state.learnt._replace(tour=None, no_room=False)
        return state.but(
            watch=unwatched(state.watch, spoilt),
            learnt=learnt,
            course=restarted(state.course),
            moved=now if moved else state.moved,
        )

    def _send(self, state: State, seen: Observation) -> State:
        """Through the gate, at the share of the speed that the mode allows; what is not finite
        there is a fault."""
        share = state.mode.share
        if not share > 0.0:
            state = state.but(course=headed(state.course, STILL, STILL))
        if state.phase in (Phase.FAULT, Phase.DISABLED):
            return state.but(command=self.gate.stop(state.command, seen.now))
        rates = state.course.rates
        passed = self.gate.admit(rates, state.command, seen.q, self.rcm, seen.now, share)
        if passed.finite:
            return state.but(command=passed.command)
        mode = Mode(Phase.FAULT, Cause.NOT_FINITE, seen.now, asks=Action.FAULT)
        stop = self.gate.stop(state.command, seen.now)
        return self._enter(state, mode, Cause.NOT_FINITE, seen).but(command=stop)
