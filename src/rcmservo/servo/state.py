"""What the servo remembers from tick to tick, in three parts: watched, learnt, decided."""

from typing import Any, NamedTuple

import numpy as np

from rcmservo.control.exploration import Exploring
from rcmservo.estimation.base import Estimate, Estimated
from rcmservo.estimation.projection_fit import Prospect, blank
from rcmservo.geometry.features import MAX_FEATURES
from rcmservo.interfaces import Command, Floats, Target
from rcmservo.numerics.structs import Row, changed, part, reals
from rcmservo.safety.causes import CAUSES, Cause
from rcmservo.safety.gate import CommandStruct, command_of
from rcmservo.safety.monitor_state import Watch
from rcmservo.safety.state_machine import PHASES, Mode, ModeStruct, Phase
from rcmservo.safety.target_progress import TargetProgress
from rcmservo.servo.setpoint import SetpointRow

NO_LINES = np.zeros((0, 4))


class Decision(TargetProgress):
    """What the servo decided: its mode, what it wants of the arm, its progress, and the last
    command.
    """

    mode: ModeStruct = part(ModeStruct, "phase, and why")
    command: CommandStruct = part(CommandStruct, "the last command")
    v: Floats = reals(3, "mm/s", "velocity wanted of marker 1")
    rates: Floats = reals(3, "rad/s, rad/s, mm/s", "the joint rates that make it")


class Workspace(Row):
    """Intermediate results of a tick. In the state they need no memory of their own."""

    p1: Floats = reals(3, "mm", "marker 1 at the exposure of a new frame")
    points: Floats = reals((2, 2), "px", "markers there, a lost one by the fit")
    m: Floats = reals(4, "px", "markers about the imaged RCM")
    m_d: Floats = reals(4, "px", "markers of the target about it")
    J_m: Floats = reals((3, 4), "rad/px, 1, 1", "∂y/∂m")
    J: Floats = reals((MAX_FEATURES, 3), "", "Jacobian of the law's features, scaled")
    error: Floats = reals(MAX_FEATURES, "", "error in these, scaled")


class Stored(Row):
    """State that a tick changes, without the estimator's memory. All of it is one row: each array
    that a compiled function is passed costs as much as what it does with it.
    """

    watch: Watch = part(Watch, "what the checks remember")
    estimate: Estimate = part(Estimate, "what frames have taught, in numbers")
    tour: Exploring = part(Exploring, "where an exploration stands")
    decision: Decision = part(Decision, "mode, wishes and command")
    prospect: Prospect = part(Prospect, "what the camera should see")
    setpoint: SetpointRow = part(SetpointRow, "target and request of this tick")
    work: Workspace = part(Workspace, "intermediate results")
    estimated: Estimated = part(Estimated, "result of the estimator for the newest frame")


class EstimatorMemory(NamedTuple):
    """Memory of an estimator that works about the imaged RCM of eq. (16).

    Parameters
    ----------
    lines : Floats
        The imaged tool's lines that eq. (16) is made of.
    memory : Any
        The estimator's own memory.
    """

    lines: Floats
    memory: Any


class Learnt(NamedTuple):
    """All that is forgotten when the estimate is learnt anew.

    Parameters
    ----------
    estimate : Estimate
        What frames have taught, in numbers.
    lines : Floats
        The imaged tool's lines that eq. (16) is made of.
    prospect : Prospect
        What the camera should see.
    memory : Any
        The estimator's own memory.
    tour : Exploring
        Where an exploration stands.
    """

    estimate: Estimate
    lines: Floats
    prospect: Prospect
    memory: Any
    tour: Exploring


def ignorance() -> dict[str, Row]:
    """Nothing learnt yet, by the parts of what is stored: Ĵ = 0."""
    unknown = dict.fromkeys(
        ("points", "o_c", "o_c_covariance", "p1", "y", "delta", "ahead"), np.nan
    )
    estimate = Estimate.of(exposure=-1, rcm_condition=np.inf, condition=np.inf, **unknown)
    return {"estimate": estimate, "prospect": blank(), "tour": Exploring.of()}


class State(NamedTuple):
    """All that the servo remembers, and what it decided at the last tick.

    Parameters
    ----------
    stored : Stored
        Its numbers.
    memory : EstimatorMemory or tuple[()]
        The estimator's memory; nothing where the fit of the projection is all that it is.
    target : Target or None
        Where it servoes to.
    detail : str
        What a person should know beside the cause's sentence, such as which joint it is.
    """

    stored: Stored
    memory: EstimatorMemory | tuple[()]
    target: Target | None = None
    detail: str = ""

    def but(
        self, *, mode: Mode | None = None, watch: Watch | None = None, learnt: Learnt | None = None
    ) -> "State":
        """The same state with some parts changed."""
        parts: dict[str, Row] = {} if watch is None else {"watch": watch}
        detail, memory = self.detail, self.memory
        if mode is not None:
            parts["decision"], detail = (
                changed(self.decision, mode=ModeStruct.from_source(mode)),
                mode.detail,
            )
        if learnt is not None:
            parts |= {name: getattr(learnt, name) for name in ("estimate", "prospect", "tour")}
            memory = self.memory and EstimatorMemory(learnt.lines, learnt.memory)
        return State(changed(self.stored, **parts), memory, self.target, detail)

    @property
    def decision(self) -> Decision:
        """What it decided: mode, wishes, command."""
        return self.stored.decision

    @property
    def watch(self) -> Watch:
        """What the checks for faults remember."""
        return self.stored.watch

    @property
    def learnt(self) -> Learnt:
        """What it has learnt of camera and tool."""
        stored = self.stored
        lines, memory = self.memory or (NO_LINES, stored.prospect.rows)
        return Learnt(stored.estimate, lines, stored.prospect, memory, stored.tour)

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
        return self.stored.tour.done

    @property
    def o_c(self) -> Floats:
        """The imaged RCM (2,) px."""
        return self.stored.estimate.o_c

    @property
    def J_hat(self) -> Floats:
        """Ĵ (3, 3) of eq. (14), rad/mm, px/mm, px/mm."""
        return self.stored.estimate.J_hat

    @property
    def condition(self) -> float:
        """Condition of the scaled Ĵ."""
        return self.stored.estimate.condition

    @property
    def p1(self) -> Floats:
        """Marker 1 (3,) mm at the exposure of the newest frame believed."""
        return self.stored.estimate.p1

    @property
    def y(self) -> Floats:
        """The features (3,) rad, px, px."""
        return self.stored.estimate.y

    @property
    def delta(self) -> Floats:
        """Δy (3,) rad, px, px at the exposure."""
        return self.stored.estimate.delta

    @property
    def v(self) -> Floats:
        """Velocity (3,) mm/s wanted of marker 1."""
        return self.decision.v

    @property
    def moved(self) -> int:
        """When the camera was last noticed to have been moved, ns; -1: never."""
        return self.decision.moved
