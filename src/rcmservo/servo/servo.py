"""The servo: features, imaged RCM, estimate, law and gate composed into one pure step.

No clock, no input, no output: the same state and observation always give the same answer. A step
looks (what a new frame shows), learns, plans (the velocity wanted of marker 1), asks what is wrong
and what follows from that (states.py), and sends what is left through the gate. What can be
compiled of it stands in core.py.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from rcmservo.errors import require
from rcmservo.guard.causes import Cause
from rcmservo.guard.gate import Gate, sent
from rcmservo.guard.states import REQUESTS, Mode, Phase, Request, standing
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Told, Watch, begin, told
from rcmservo.interfaces import Floats, Observation, Target
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.compiled_ones import AnyRule, rule_of
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.exploration import Exploration, Exploring
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.method.kinematics import Kinematics, Rcm, floats, position
from rcmservo.method.tool import Tool
from rcmservo.rows import Rows, as_row, changed
from rcmservo.servo.act import Kept, act
from rcmservo.servo.diagnosis import detail
from rcmservo.servo.dials import Asked, Dials, Fixed
from rcmservo.servo.look import LEARN, learn, look
from rcmservo.servo.one_kernel import tick
from rcmservo.servo.own_estimator import examine, failure, learner, time_anew
from rcmservo.servo.state import Decision, Estimate, Learnt, State, ignorance

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
    def dials(self) -> Rows[Dials]:
        """What the compiled parts know of the boxes."""
        law, rcm = self.controller, self.rcm
        return Dials.of(
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
    def rule(self) -> AnyRule | None:
        """What they know of the estimator; None where it does not compile."""
        return rule_of(self.estimator)

    @cached_property
    def fixed(self) -> Fixed:
        """What the compiled parts know of all this."""
        return Fixed(
            self.dials,
            as_row(self.thresholds),
            self.gate.row,
            self.exploration.row,
            self.tool.shaft,
        )

    def marker_1(self, q: Floats) -> Floats:
        """p₁ (3,) mm at the joints q (3,)."""
        return position(self.rcm, q)

    def init(self) -> State:
        """Nothing seen, nothing known: Ĵ = 0, drive off."""
        decision = Decision.of(**sent(self.gate.rest()), blocked=-1, peak=np.inf, moved=-1)
        return State(decision, begin(), self._ignorance())

    def _ignorance(self) -> Learnt:
        return ignorance(self.imaged_rcm.init()[0], self.learner.init())

    def again(self, state: State) -> State:
        """The state to begin another run with: drive off, at rest, with what was learnt. A fault
        stays one.

        The tool may have been moved by hand since, but if the camera was, nothing but a new look
        can tell.
        """
        mode = state.mode if state.phase is Phase.FAULT else Mode()
        decision = changed(state.decision, **standing(mode), **sent(self.gate.rest()))
        learnt, places = state.learnt, state.learnt.estimate
        if not state.explored:
            learnt = self._ignorance()
            estimate = changed(learnt.estimate, points=places.points, p1=places.p1)
        else:
            estimate = changed(places, exposure=-1)
        tour = changed(learnt.tour, begun=False, no_room=False)
        learnt = learnt._replace(estimate=estimate, tour=tour)
        return state._replace(decision=decision, watch=begin(), learnt=learnt, detail=mode.detail)

    def warm_up(self) -> None:
        """Compile all that `step` calls, on made-up observations, so that nothing compiles while an
        arm moves. A user's own estimator is tried first, and refused if it fails."""
        examine(self.estimator, self.tool)
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
        self, state: State, seen: Observation, target: Target, request: Request = Request.NONE
    ) -> State:
        """One tick: learn from the frame if it is new, decide, and pass the decision through the
        gate.

        ``request`` is what a person asks for at this tick.
        """
        last = state.decision
        numbers = told(seen, seen.now - last.time if last.number > 0 else self.period)
        asked = Asked(
            target.points, target.shown, target is not state.target, REQUESTS.index(request)
        )
        learnt, failed = state.learnt, ""
        kept = Kept(
            state.watch.rows, learnt.estimate.rows, learnt.tour.rows, last.rows, learnt.lines
        )
        if self.rule is not None:
            kept, memory = tick(kept, learnt.memory, numbers, asked, self.fixed, self.rule)
        else:
            kept, memory, failed = self._by_parts(kept, learnt.memory, numbers, asked)
        watch, estimate, tour, decision, lines = kept
        learnt = Learnt(Estimate(estimate), lines, memory, Exploring(tour))
        after = State(Decision(decision), Watch(watch), learnt, target, state.detail)
        if after.decision.cause == last.cause:
            return after
        return after._replace(detail=failed or self._detail(after, seen))

    def _by_parts(self, kept: Kept, memory: Any, seen: Told, asked: Asked) -> tuple[Kept, Any, str]:
        """`tick` with another estimator, and how that failed."""
        explored, fixed = Exploring(kept.tour).done, self.fixed
        watch, estimate, lines, news, dt = look(
            kept.watch, kept.estimate, kept.lines, seen, explored, fixed
        )
        if news == LEARN:
            e = Estimate(estimate)
            sample = Sample(e.p1, seen.points, e.o_c, dt)
            memory = self.learner.update(memory, self.tool, sample)
            J_hat = self.learner.jacobian(memory, self.tool, sample)
            points = self.learner.located(memory, self.tool, sample)
            learn(estimate, J_hat, points, asked.points, seen.exposure)
        failed = failure(memory)
        more = Cause.ESTIMATOR_FAILED.bit if failed else 0
        now = Kept(watch, estimate, kept.tour, kept.decision, lines)
        after, forgot = act(now, news, more, seen, asked, fixed)
        return after, self.learner.init() if forgot else memory, failed

    def _detail(self, state: State, seen: Observation) -> str:
        """What a person should know of a cause that is new."""
        if state.cause is Cause.NOT_EXPLORED:
            return self.estimator.advice
        return detail(state.cause, state.watch, seen, self.mechanism, self.thresholds)
