"""The servo: features, imaged RCM, estimate, law and gate composed into one pure step.

No clock, no input, no output: the same state and observation always give the same answer. A step
looks (what a new frame shows), learns, plans (the velocity wanted of marker 1), asks what is wrong
and what follows from that (states.py), and sends what is left through the gate. What can be
compiled of it is one function in one_kernel.py.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from rcmservo.constraints import Checked
from rcmservo.errors import require
from rcmservo.guard.checks.facts import DetailFacts
from rcmservo.guard.gate import CommandStruct, Gate
from rcmservo.guard.states import REQUESTS, Mode, ModeStruct, Phase, Request
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import begin
from rcmservo.interfaces import Floats, Observation, ObservationStruct, Target, observed_numbers
from rcmservo.method.controller import ROWS, SaturatedController
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.foresight import located
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.method.kinematics import Kinematics, Rcm, position
from rcmservo.method.tool import Tool
from rcmservo.rows import Rows, as_row, changed, copied
from rcmservo.servo.act import act
from rcmservo.servo.compiled_ones import AnyRule, rule_of
from rcmservo.servo.kernel_parameters import Asked, KernelParameters
from rcmservo.servo.learn import (
    LEARN,
    learn,
    learn_points,
    learn_sizes,
    learn_straight,
    line_up,
    place_rcm,
)
from rcmservo.servo.look import look
from rcmservo.servo.one_kernel import tick
from rcmservo.servo.own_estimator import examine, failure, learner, time_anew
from rcmservo.servo.state import Beside, Decision, Kept, State, ignorance

Both = tuple[Floats, Floats]
STILL = np.zeros(3)
WARM_UP = 8


@dataclass(frozen=True)
class Servo(Checked):
    """The paper's block diagram. What the robot knows of itself, and a choice for every box."""

    mechanism: Kinematics
    """The arm's kinematics."""
    tool: Tool
    """Where the markers are on the tool."""
    estimator: Estimator = field(default_factory=DltEstimator)
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
        super().__post_init__()
        good = self.rate * self.gate.deadline >= 2.0 and self.rate <= 1000.0
        right = "at least two ticks in gate.deadline, and at most 1000 Hz"
        require(good, "rate", self.rate, right)
        features, estimator = self.controller.features, self.estimator
        known = features == "srd" or estimator.tells_motion
        right = "'srd', or an estimator that tells the markers' motion, such as dlt or projection"
        require(known, "controller.features", features, right)
        known = features != "size" or estimator.tells_size_motion
        right = "'srd' or 'points', or an estimator that tells how sizes change, such as affine"
        require(known, "controller.features", features, right)

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
    def rule(self) -> AnyRule | None:
        """What they know of the estimator; None where it does not compile."""
        return rule_of(self.estimator)

    @cached_property
    def fixed(self) -> Rows[KernelParameters]:
        """What the compiled parts know of all this."""
        return as_row(
            KernelParameters(
                rcm=self.rcm,
                tool=self.tool.shaft,
                controller=self.controller,
                features=ROWS[self.controller.features],
                printed_potential=self.controller.potential == "printed",
                imaged_rcm=self.imaged_rcm,
                printed_rcm=self.imaged_rcm.printed,
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
        known = self.controller.features != "size" or bool(np.isfinite(target.sizes).all())
        right = "shown with the markers' sizes, on which controller.features = 'size' acts"
        require(known, "target", "one without", right)

    def init(self) -> State:
        """Nothing seen, nothing known: Ĵ = 0, drive off."""
        rest = CommandStruct.from_source(self.gate.rest())
        decision = Decision.of(command=rest, blocked=-1, astray=-1, peak=np.inf, moved=-1)
        kept = Kept.of(decision=decision, watch=begin(), **ignorance())
        return State(kept, self._nothing())

    def _nothing(self) -> Beside | tuple[()]:
        """What is remembered beside while nothing is known."""
        return Beside(self.imaged_rcm.init()[0], self.learner.init()) if self.rule != () else ()

    def again(self, state: State) -> State:
        """The state to begin another run with: drive off, at rest, with what was learnt. A fault
        stays one.

        The tool may have been moved by hand since, but if the camera was, nothing but a new look
        can tell.
        """
        mode = state.mode if state.phase is Phase.FAULT else Mode()
        rest = CommandStruct.from_source(self.gate.rest())
        decision = changed(state.decision, mode=ModeStruct.from_source(mode), command=rest)
        parts, beside, places = ignorance(), state.beside, state.kept.estimate
        if state.explored:
            tour = changed(state.kept.tour, begun=False, no_room=False)
            parts = {"estimate": changed(places, exposure=-1), "tour": tour}
        else:
            known = {"points": places.points, "p1": places.p1}
            parts["estimate"], beside = changed(parts["estimate"], **known), self._nothing()
        kept = changed(state.kept, decision=decision, watch=begin(), **parts)
        return State(kept, beside, state.target, mode.detail)

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
        self,
        state: State,
        seen: Observation,
        target: Target,
        request: Request = Request.NONE,
        jog: Floats = STILL,
    ) -> State:
        """One tick: learn from the frame if it is new, decide, and pass the decision through the
        gate.

        ``request`` is what a person asks for at this tick, ``jog`` the joint rates (3,) where that
        is to move them by hand.
        """
        kept = copied(state.kept)
        numbers, other = observed_numbers(seen), target is not state.target
        asked = (target.points, target.q, target.shown, other, REQUESTS.index(request), jog)
        beside, failed = state.beside, ""
        if self.rule is not None:
            beside, new = tick(kept.rows, beside, numbers, asked, self.fixed, self.rule)
        else:
            seen_so, asked_so = ObservationStruct(*numbers), Asked(*asked)
            sizes = seen.sizes, target.sizes
            beside, failed = self._by_parts(kept, beside, seen_so, asked_so, sizes)
            new = kept.decision.mode.cause != state.decision.mode.cause
        after = State(kept, beside, target, state.detail)
        return after._replace(detail=failed or self._detail(after, seen)) if new else after

    def _by_parts(
        self, kept: Kept, beside: Any, seen: ObservationStruct, asked: Asked, sizes: Both
    ) -> tuple[Beside, str]:
        """`tick` with another estimator, and how that failed; `sizes` are those seen and those of
        the target."""
        rows, (lines, memory) = kept.rows, beside
        news, dt = look(rows, seen, self.fixed)
        if news == LEARN:
            lines, news = line_up(rows, lines, seen.points, self.fixed)
            if news == LEARN or self.estimator.places_rcm:
                news, memory = LEARN, self._learn(kept, memory, seen, asked.points, dt, sizes)
        failed = failure(memory)
        if act(rows, news, failed != "", seen, asked, self.fixed):
            lines, memory = np.zeros_like(lines), self.learner.init()
        return Beside(lines, memory), failed

    def _learn(
        self,
        kept: Kept,
        memory: Any,
        seen: ObservationStruct,
        target: Floats,
        dt: float,
        sizes: Both,
    ) -> Any:
        """The memory after one new frame; Ĵ and features go into the estimate, with a lost marker
        where the fit of all frames has it."""
        learner, rows, e = self.learner, kept.rows, kept.estimate
        sample = Sample(e.p1, seen.points, e.o_c, dt, sizes[0])
        memory = learner.update(memory, self.tool, sample)
        points = learner.located(memory, self.tool, sample)
        if not np.isfinite(seen.points).all():
            fitted = located(kept.prospect.rows[0], e.p1, self.tool.shaft)
            points = np.where(np.isfinite(seen.points), points, fitted)
        placed = learner.imaged_rcm(memory)
        if placed is None:
            J_hat = learner.jacobian(memory, self.tool, sample)
            learn(rows, J_hat, points, target, seen.exposure)
        else:
            place_rcm(rows, *placed)
            motion = learner.motion(memory, self.tool, sample)
            learn_straight(rows, motion, points, target, seen.exposure)
        if self.controller.features != "srd":
            motion = learner.motion(memory, self.tool, sample)
            learn_points(rows, motion, points, target)
        if self.controller.features == "size":
            motion = learner.size_motion(memory, self.tool, sample)
            learn_sizes(rows, motion, seen.points, *sizes)
        return memory

    def _detail(self, state: State, seen: Observation) -> str:
        """What a person should know of a cause that is new."""
        advice = self.estimator.advice
        facts = DetailFacts(seen, state.watch, self.mechanism, self.thresholds, advice)
        return state.cause.declared.detail(facts)
