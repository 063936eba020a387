"""What the servo remembers from tick to tick, in three parts: watched, learnt, decided."""

from typing import Any, NamedTuple

import numpy as np

from rcmservo.guard.causes import CAUSES, Cause
from rcmservo.guard.gate import CommandStruct, command_of
from rcmservo.guard.states import PHASES, Mode, ModeStruct, Phase
from rcmservo.guard.watch import Watch
from rcmservo.interfaces import Command, Floats, Target
from rcmservo.method.controller import MOST
from rcmservo.method.exploration import Exploring
from rcmservo.method.features import FEATURES
from rcmservo.method.prospect import Prospect, blank
from rcmservo.rows import Row, changed, flag, part, real, reals, whole

NO_LINES = np.zeros((0, 4))


class Estimate(Row):
    """What frames have taught, in numbers; NaN where not known yet."""

    exposure: int = whole("ns", "of the newest frame learnt from, -1 before the first")
    points: Floats = reals((2, 2), "px", "the markers in the newest frame believed")
    p1: Floats = reals(3, "mm", "marker 1 in space at that exposure")
    line_count: int = whole("", "lines of the tool kept for eq. (16)")
    o_c: Floats = reals(2, "px", "the imaged RCM")
    o_c_covariance: Floats = reals((2, 2), "px²", "of o_c, where a fit of the projection tells it")
    rcm_condition: float = real("", "condition of eq. (16), 0 where o_c is of such a fit")
    J_hat: Floats = reals((FEATURES, 3), "rad/mm, px/mm, px/mm", "Ĵ of eq. (14)")
    condition: float = real("", "condition of the scaled Ĵ")
    motion: Floats = reals(
        (MOST, 3), "px/mm", "∂/∂p₁ of u₁ v₁ u₂ v₂ R₁ R₂, where the law acts on it"
    )
    off: Floats = reals(MOST, "px", "how far these are from the target at the exposure, where so")
    y: Floats = reals(FEATURES, "rad, px, px", "the features, eq. (6)")
    delta: Floats = reals(FEATURES, "rad, px, px", "Δy at the exposure")
    ahead: Floats = reals(FEATURES, "rad, px, px", "Δy as predicted for now")


class Decision(Row):
    """What the servo decided: its mode, what it wants of the arm, how it gets on, and the last
    command."""

    mode: ModeStruct = part(ModeStruct, "phase, and why")
    command: CommandStruct = part(CommandStruct, "the last command")
    v: Floats = reals(3, "mm/s", "velocity wanted of marker 1")
    rates: Floats = reals(3, "rad/s, rad/s, mm/s", "the joint rates that make it")
    blocked: int = whole("", "the joint whose limit stands in the way, -1 for none")
    open: float = real("", "share of the error that the damped law works off, 1 where it is small")
    left: float = real("mm", "how far marker 1 is from the target by the picture")
    arrived: bool = flag("whether the joints have been where the target was shown")
    astray: int = whole("ns", "since when it is elsewhere than the target's joints, -1: not so")
    peak: float = real("", "the error √(2V) that has last been fallen short of")
    peak_time: int = whole("ns", "when that was")
    moved: int = whole("ns", "when the camera was last noticed to have been moved, -1: never")


class Kept(Row):
    """What a tick changes, but for what an estimator remembers beside it. All of it is one row:
    each array that a compiled function is passed costs as much as what it does with it."""

    watch: Watch = part(Watch, "what the checks remember")
    estimate: Estimate = part(Estimate, "what frames have taught, in numbers")
    tour: Exploring = part(Exploring, "where an exploration stands")
    decision: Decision = part(Decision, "mode, wishes and command")
    prospect: Prospect = part(Prospect, "what the camera should see")


class Beside(NamedTuple):
    """What is remembered beside, for which no row has room."""

    lines: Floats
    """The imaged tool's lines that eq. (16) is made of."""
    memory: Any
    """The estimator's own memory."""


class Learnt(NamedTuple):
    """All that is forgotten when the estimate is learnt anew."""

    estimate: Estimate
    """What frames have taught, in numbers."""
    lines: Floats
    """The imaged tool's lines that eq. (16) is made of."""
    prospect: Prospect
    """What the camera should see."""
    memory: Any
    """The estimator's own memory."""
    tour: Exploring
    """Where an exploration stands."""


def ignorance() -> dict[str, Row]:
    """Nothing learnt yet, by the parts of a Kept: Ĵ = 0."""
    unknown = dict.fromkeys(
        ("points", "o_c", "o_c_covariance", "p1", "y", "delta", "ahead"), np.nan
    )
    estimate = Estimate.of(exposure=-1, rcm_condition=np.inf, condition=np.inf, **unknown)
    return {"estimate": estimate, "prospect": blank(), "tour": Exploring.of()}


class State(NamedTuple):
    """All that the servo remembers, and what it decided at the last tick."""

    kept: Kept
    """Its numbers."""
    beside: Beside | tuple[()]
    """What it remembers beside; nothing where what the camera should see is all the estimator
    is."""
    target: Target | None = None
    """Where it servoes to."""
    detail: str = ""
    """What a person should know beside the cause's sentence, such as which joint it is."""

    def but(
        self, *, mode: Mode | None = None, watch: Watch | None = None, learnt: Learnt | None = None
    ) -> "State":
        """The same state with some parts changed."""
        parts: dict[str, Row] = {} if watch is None else {"watch": watch}
        detail, beside = self.detail, self.beside
        if mode is not None:
            parts["decision"], detail = (
                changed(self.decision, mode=ModeStruct.from_source(mode)),
                mode.detail,
            )
        if learnt is not None:
            parts |= {name: getattr(learnt, name) for name in ("estimate", "prospect", "tour")}
            beside = self.beside and Beside(learnt.lines, learnt.memory)
        return State(changed(self.kept, **parts), beside, self.target, detail)

    @property
    def decision(self) -> Decision:
        """What it decided: mode, wishes, command."""
        return self.kept.decision

    @property
    def watch(self) -> Watch:
        """What the checks for faults remember."""
        return self.kept.watch

    @property
    def learnt(self) -> Learnt:
        """What it has learnt of camera and tool."""
        kept = self.kept
        lines, memory = self.beside or (NO_LINES, kept.prospect.rows)
        return Learnt(kept.estimate, lines, kept.prospect, memory, kept.tour)

    @property
    def mode(self) -> Mode:
        """Its phase, and why."""
        return Mode(**self.decision.mode.values(), detail=self.detail)

    @property
    def command(self) -> Command:
        """What the gate passed."""
        return command_of(self.decision.command)

    @property
    def phase(self) -> Phase:
        """What the servo is doing."""
        return PHASES[int(self.decision.mode.phase)]

    @property
    def cause(self) -> Cause:
        """Why it is not simply on its way."""
        return CAUSES[int(self.decision.mode.cause)]

    @property
    def words(self) -> str:
        """Phase, cause and way out in words."""
        return self.mode.words

    @property
    def frame(self) -> int:
        """The newest frame seen, -1 before the first."""
        return self.watch.frame

    @property
    def believed(self) -> int:
        """The newest frame accepted, -1 before the first."""
        return self.watch.believed

    @property
    def explored(self) -> bool:
        """Whether there is an estimate to servo with."""
        return self.kept.tour.done

    @property
    def o_c(self) -> Floats:
        """The imaged RCM (2,) px."""
        return self.kept.estimate.o_c

    @property
    def J_hat(self) -> Floats:
        """Ĵ (3, 3) of eq. (14), rad/mm, px/mm, px/mm."""
        return self.kept.estimate.J_hat

    @property
    def condition(self) -> float:
        """Condition of the scaled Ĵ."""
        return self.kept.estimate.condition

    @property
    def p1(self) -> Floats:
        """Marker 1 (3,) mm at the exposure of the newest frame believed."""
        return self.kept.estimate.p1

    @property
    def y(self) -> Floats:
        """The features (3,) rad, px, px."""
        return self.kept.estimate.y

    @property
    def delta(self) -> Floats:
        """Δy (3,) rad, px, px at the exposure."""
        return self.kept.estimate.delta

    @property
    def v(self) -> Floats:
        """Velocity (3,) mm/s wanted of marker 1."""
        return self.decision.v

    @property
    def moved(self) -> int:
        """When the camera was last noticed to have been moved, ns; -1: never."""
        return self.decision.moved
