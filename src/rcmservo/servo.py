"""The servo: features, imaged RCM, estimate, law and gate composed into one pure step.

No clock, no input, no output: the same state and observation always give the same answer. Expected events are causes,
values with a sentence for a person; with a cause the tool is held still, and after a second only a person starts it
again. (The full table of faults has its place here: `_cause`, and the transitions in `_phase`.)
"""

import math
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from rcmservo.controller import SaturatedController, control
from rcmservo.estimators.base import Estimator, Sample
from rcmservo.estimators.projection import ProjectionEstimator
from rcmservo.exploration import Exploration, Exploring
from rcmservo.features import SCALE, measured, surprise
from rcmservo.imaged_rcm import ImagedRcm, follow
from rcmservo.mechanism import Kinematics, blocked, joint_rates, position
from rcmservo.plant import Command, Floats, Observation, Target
from rcmservo.safety import Gate
from rcmservo.tool import Tool

HOLD_TIME = 1_000_000_000
"""ns of HOLD after which only a person resumes."""

STALE_TIME = 300_000_000
"""ns since the exposure of the newest frame after which the servo no longer moves on what it shows."""

SURPRISE = 2.0
"""Scaled feature change beyond the predicted one, and as much again as was predicted, that no tool's motion makes."""

NO_PIXEL = 1e6
"""px from where on a coordinate is no marker's."""

GOOD_FRAMES = 5
"""New frames without a cause that end a HOLD."""

STALL_TIME = 6_000_000_000
STALL_FALL = 0.2
STALL_SHARE = 0.02
STALL_ERROR = 0.5
"""A scaled error √(2V) above STALL_ERROR that has not fallen by STALL_FALL, or by STALL_SHARE of itself, in STALL_TIME
ns has stalled."""

LIMIT_HORIZON = 0.1
LIMIT_SHARE = 0.3
"""A joint that would pass its limit within LIMIT_HORIZON s blocks the way if less than LIMIT_SHARE of the speed is left
without it."""


class Phase(Enum):
    """What the servo is doing."""

    IDLE = "idle"
    ACQUIRE = "exploring"
    SERVO = "servoing"
    HOLD = "holding still"
    PAUSED = "paused"


class Cause(Enum):
    """Why the tool is held: a sentence for a person."""

    NONE = ""
    MARKER_1_LOST = "marker 1 is not seen: it left the picture or is hidden"
    MARKER_2_LOST = "marker 2 is not seen: it left the picture or is hidden"
    MARKERS_LOST = "neither marker is seen: they left the picture or are hidden"
    STALE = "no new frame has come from the camera for too long"
    SURPRISED = "the markers are not where the tool's motion puts them: mistaken or swapped, or the camera moved"
    JOINTS_UNKNOWN = "the joints' positions at the exposure of the frame are not known"
    RCM_UNKNOWN = "the imaged RCM cannot be computed: the lines seen of the tool are too much alike"
    SINGULAR = "the target lies at or beyond a singular surface: the scaled Jacobian's condition passed its limit"
    JOINT_1_LIMIT = "the way to the target goes past the limit of joint 1"
    JOINT_2_LIMIT = "the way to the target goes past the limit of joint 2"
    JOINT_3_LIMIT = "the way to the target goes past the limit of joint 3"
    NO_ROOM = "the joint limits leave no room to explore around the start"
    NOT_EXPLORED = "exploration ended without an estimate that predicts what the camera sees"
    STALLED = "the feature error has stopped falling: the target cannot be reached from here"
    NOT_FINITE = "a number that is not finite reached the last gate"


MARKER_CAUSES = {
    (True, False): Cause.MARKER_1_LOST,
    (False, True): Cause.MARKER_2_LOST,
    (True, True): Cause.MARKERS_LOST,
}
LIMIT_CAUSES = (Cause.JOINT_1_LIMIT, Cause.JOINT_2_LIMIT, Cause.JOINT_3_LIMIT)
FINAL_CAUSES = {Cause.NO_ROOM, Cause.NOT_EXPLORED, Cause.STALLED, Cause.NOT_FINITE}


def _finite(numbers: Floats) -> bool:
    """Whether all are finite; NumPy's own way takes ten times as long on three numbers."""
    return all(map(math.isfinite, numbers.tolist()))


def _lost(points: Floats) -> tuple[bool, bool]:
    """Whether marker 1 and marker 2 are lost: raw pixels (2, 2) not finite, or such as no camera has."""
    (u1, v1), (u2, v2) = points.tolist()
    return not (abs(u1) < NO_PIXEL and abs(v1) < NO_PIXEL), not (abs(u2) < NO_PIXEL and abs(v2) < NO_PIXEL)


@dataclass(frozen=True, eq=False)
class State:
    """All that the servo remembers, and what it decided at the last tick.

    ``frame`` is the newest seen, not believed if ``surprised``; ``exposure`` ns that of the newest learnt from (-1:
    none). ``o_c`` (2,) px and ``rcm_condition`` of eq. (16); ``J_hat`` (3, 3) and its scaled ``condition``; ``y`` and
    ``delta`` = Δy (3,) of the newest frame learnt from; ``p1`` (3,) mm at that exposure; ``v`` (3,) mm/s wanted of
    marker 1; ``command`` as the gate passed it; ``peak`` the error √(2V) to the ``target`` that has last been fallen
    short of, at ``peak_time`` ns. NaN where not known yet.
    """

    phase: Phase
    cause: Cause
    command: Command
    frame: int
    surprised: bool
    exposure: int
    lines: Floats
    line_count: int
    o_c: Floats
    rcm_condition: float
    memory: Any
    tour: Exploring | None
    explored: bool
    p1: Floats
    J_hat: Floats
    condition: float
    y: Floats
    delta: Floats
    v: Floats
    held_since: int
    good_frames: int
    blocked: int
    target: Target | None
    peak: float
    peak_time: int

    def but(self, **changes: Any) -> "State":
        """The same state with some fields changed: dataclasses.replace, without its cost in every tick."""
        state = object.__new__(State)
        state.__dict__.update(self.__dict__, **changes)
        return state


@dataclass(frozen=True)
class Servo:
    """The paper's block diagram. What the robot knows of itself, and a choice for every box."""

    mechanism: Kinematics
    tool: Tool
    estimator: Estimator = field(default_factory=ProjectionEstimator)
    controller: SaturatedController = field(default_factory=SaturatedController)
    exploration: Exploration = field(default_factory=Exploration)
    imaged_rcm: ImagedRcm = field(default_factory=ImagedRcm)
    gate: Gate = field(default_factory=Gate)

    WARM_UP: ClassVar[int] = 8

    @cached_property
    def zero(self) -> float:
        """ρ of marker 1 (mm) where the insertion joint reads zero."""
        return self.mechanism.insertion_zero + self.tool.offset

    def marker_1(self, q: Floats) -> Floats:
        """p₁ (3,) mm at the joints q (3,)."""
        return position(self.mechanism.kind, self.zero, q)

    def init(self) -> State:
        """Nothing seen, nothing known: Ĵ = 0."""
        lines, count = self.imaged_rcm.init()
        unknown = np.full(3, np.nan)
        return State(
            phase=Phase.IDLE,
            cause=Cause.NONE,
            command=self.gate.rest(),
            frame=-1,
            surprised=False,
            exposure=-1,
            lines=lines,
            line_count=count,
            o_c=np.full(2, np.nan),
            rcm_condition=np.inf,
            memory=self.estimator.init(),
            tour=None,
            explored=False,
            p1=unknown,
            J_hat=np.zeros((3, 3)),
            condition=np.inf,
            y=unknown,
            delta=unknown,
            v=np.zeros(3),
            held_since=0,
            good_frames=0,
            blocked=-1,
            target=None,
            peak=np.inf,
            peak_time=0,
        )

    def warm_up(self) -> None:
        """Compile all that `step` calls, on made-up observations, so that nothing compiles while an arm moves."""
        state = self.init()
        q = (np.array(self.mechanism.limits.lower) + np.array(self.mechanism.limits.upper)) / 2.0
        points = np.array([[100.0, 50.0], [200.0, 100.0]])
        target = Target(points, q)
        for k in range(self.WARM_UP):
            turned = points + k * np.array([[0.0, 0.0], [3.0, -9.0]])
            seen = Observation(now=k + 1, q=q, frame=k, exposure=k, q_exposure=q + 1e-3 * k, points=turned)
            state = self.step(state, seen, target)
            if state.tour is not None:
                tour = self.exploration.visit(state.tour, state.p1, turned)
                self.exploration.complete(tour._replace(visits=4 * self.exploration.rounds), state.J_hat, state.o_c)
            if k > self.WARM_UP // 2:
                state = state.but(phase=Phase.SERVO, explored=True, J_hat=np.diag(SCALE))

    def step(self, state: State, seen: Observation, target: Target) -> State:
        """One tick: learn from the frame if it is new, decide, and pass the decision through the gate."""
        if target is not state.target:
            state = state.but(target=target, peak=np.inf)
        new = seen.frame > state.frame
        if new:
            state = self._look(state, seen, target)
        state = self._decide(state, seen, new)
        return self._send(state, seen)

    def _look(self, state: State, seen: Observation, target: Target) -> State:
        """What a new frame teaches: the imaged RCM, Ĵ, and the error."""
        p1 = self.marker_1(seen.q_exposure)
        if any(_lost(seen.points)) or not _finite(p1):
            return state.but(frame=seen.frame)
        if self._surprised(state, p1, seen.points):
            return state.but(frame=seen.frame, surprised=True)
        lines, count, o_c, rcm_condition = follow(
            state.lines, state.line_count, seen.points, self.imaged_rcm.refinements
        )
        memory, J_hat, y, delta, exposure = state.memory, state.J_hat, state.y, state.delta, state.exposure
        if rcm_condition <= self.imaged_rcm.max_condition:
            exposure = seen.exposure
            dt = (exposure - state.exposure) * 1e-9 if state.exposure >= 0 else 0.0
            sample = Sample(p1, seen.points, o_c, dt)
            memory = self.estimator.update(memory, self.tool, sample)
            J_hat = self.estimator.jacobian(memory, self.tool, sample)
            y, delta = measured(seen.points, target.points, o_c)
        return state.but(
            frame=seen.frame,
            surprised=False,
            exposure=exposure,
            lines=lines,
            line_count=count,
            o_c=o_c,
            rcm_condition=rcm_condition,
            memory=memory,
            p1=p1,
            J_hat=J_hat,
            y=y,
            delta=delta,
        )

    def _surprised(self, state: State, p1: Floats, points: Floats) -> bool:
        """Whether the markers have moved as no tool does; told only once Ĵ and o_c are known."""
        known = state.explored and state.rcm_condition <= self.imaged_rcm.max_condition
        return known and surprise(points, state.o_c, state.y, state.J_hat, p1 - state.p1) > SURPRISE

    def _decide(self, state: State, seen: Observation, new: bool) -> State:
        """The velocity wanted of marker 1 in the present phase, and the phase itself."""
        if state.phase is Phase.PAUSED or state.frame < 0:
            return state.but(v=np.zeros(3))
        if state.phase is Phase.IDLE:
            state = self._begin(state, seen)
        if not state.explored and state.tour is not None:
            state = self._explore(state, state.tour, seen, new)
        if new and state.explored:
            state = self._servo(state, seen)
        return self._phase(state, self._cause(state, seen), seen.now, new)

    def _begin(self, state: State, seen: Observation) -> State:
        tour = self.exploration.begin(self.mechanism, self.zero, seen.q, seen.now)
        return state.but(phase=Phase.ACQUIRE, tour=tour)

    def _explore(self, state: State, tour: Exploring, seen: Observation, new: bool) -> State:
        p1 = self.marker_1(seen.q)
        if new and not any(_lost(seen.points)) and self.exploration.arrived(tour, p1):
            tour = self.exploration.visit(tour, state.p1, seen.points)
            if self.exploration.complete(tour, state.J_hat, state.o_c):
                return state.but(tour=tour, explored=True, phase=Phase.SERVO, v=np.zeros(3))
        return state.but(tour=tour, v=self.exploration.velocity(tour, p1))

    def _servo(self, state: State, seen: Observation) -> State:
        law_ = self.controller
        v, condition, error = control(
            state.J_hat, state.delta, law_.b, law_.potential == "printed", law_.gain, law_.max_condition, law_.max_speed
        )
        peak, peak_time = max(state.peak, error), state.peak_time
        if error < peak - min(STALL_FALL, STALL_SHARE * peak):
            peak, peak_time = error, seen.now
        return state.but(
            v=v,
            condition=condition,
            blocked=blocked(
                self.mechanism.kind, self.zero, seen.q, v, *self.mechanism.limits.arrays, LIMIT_HORIZON, LIMIT_SHARE
            ),
            peak=peak,
            peak_time=peak_time,
        )

    def _cause(self, state: State, seen: Observation) -> Cause:
        """The reason to hold still, if there is one; the gravest first."""
        if state.tour is None:
            return Cause.NO_ROOM
        blind = self._blind(state, seen)
        if blind is not Cause.NONE:
            return blind
        return self._servo_cause(state, seen) if state.explored else self._tour_cause(state.tour, seen)

    def _blind(self, state: State, seen: Observation) -> Cause:
        """Why what was seen last cannot be used."""
        lost = _lost(seen.points)
        if any(lost):
            return MARKER_CAUSES[lost]
        if seen.now - seen.exposure > STALE_TIME:
            return Cause.STALE
        if not _finite(seen.q_exposure):
            return Cause.JOINTS_UNKNOWN
        return Cause.SURPRISED if state.surprised else Cause.NONE

    def _tour_cause(self, tour: Exploring, seen: Observation) -> Cause:
        return Cause.NOT_EXPLORED if self.exploration.overdue(tour, seen.now) else Cause.NONE

    def _servo_cause(self, state: State, seen: Observation) -> Cause:
        if not state.rcm_condition <= self.imaged_rcm.max_condition:
            return Cause.RCM_UNKNOWN
        if not state.condition < self.controller.max_condition:
            return Cause.SINGULAR
        if state.blocked >= 0:
            return LIMIT_CAUSES[state.blocked]
        stalled = state.peak > STALL_ERROR and seen.now - state.peak_time > STALL_TIME
        return Cause.STALLED if stalled else Cause.NONE

    def _phase(self, state: State, cause: Cause, now: int, new: bool) -> State:
        """The next phase: a cause holds at once, a second of it pauses, and good frames end a hold."""
        if cause in FINAL_CAUSES:
            return state.but(phase=Phase.PAUSED, cause=cause, v=np.zeros(3))
        if cause is not Cause.NONE:
            since = state.held_since if state.phase is Phase.HOLD else now
            phase = Phase.PAUSED if now - since > HOLD_TIME else Phase.HOLD
            return state.but(phase=phase, cause=cause, held_since=since, good_frames=0, v=np.zeros(3))
        if state.phase is Phase.HOLD:
            good = state.good_frames + new
            if good < GOOD_FRAMES:
                return state.but(good_frames=good, v=np.zeros(3))
            phase = Phase.SERVO if state.explored else Phase.ACQUIRE
            return state.but(phase=phase, cause=Cause.NONE, good_frames=0)
        return state

    def _send(self, state: State, seen: Observation) -> State:
        """Through the gate; what is not finite there ends the run."""
        rates = joint_rates(self.mechanism.kind, self.zero, seen.q, state.v)
        passed = self.gate.admit(rates, state.command, seen.q, self.mechanism.limits, seen.now)
        state = state.but(command=passed.command)
        return state if passed.finite else state.but(phase=Phase.PAUSED, cause=Cause.NOT_FINITE)
