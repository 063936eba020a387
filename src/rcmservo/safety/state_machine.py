"""What the servo may do: its phases, and the function that leads from phase to phase.

    DISABLED ─► IDLE ─► ACQUIRE ─► SERVO        FAULT ─ clear ─► DISABLED
                 │        ▲  ▲       │          (from everywhere, latched)
                 │ resume │  └ HOLD ◄┤
                 │        └─ PAUSED ◄┘
                 └─► JOG ◄─────┘                JOG ends in PAUSED

Every cause asks for an action, and the greatest of those present wins, so that one more fault never
softens the answer. HOLD ramps to zero and recovers by itself; from PAUSED only a person resumes,
always into ACQUIRE; FAULT is zero at once with the drive off, and only `CLEAR` with its causes gone
leads out of it. In JOG a person moves the joints, and must ask for it at every tick: no picture and
no estimate is needed, so nothing stops it but a fault and a loop that runs late. No clock here: the
time is an argument.
"""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Struct
from rcmservo.safety.causes import ACTIONS, Action, Cause, graver, gravest
from rcmservo.safety.thresholds import Thresholds

SLOW_SHARE = 0.2
"""Share of the full speed in ACQUIRE and JOG, and while a cause asks for SLOW."""


class Phase(Enum):
    """What the servo is doing."""

    DISABLED = "drive off"
    IDLE = "waiting for the markers"
    ACQUIRE = "acquiring"
    SERVO = "servoing"
    HOLD = "holding still"
    PAUSED = "paused"
    JOG = "moved by a person"
    FAULT = "fault"


class Request(Enum):
    """What a person asks for: nothing, a pause, to go on after one, to leave a fault, or to move
    the joints by hand at this tick.
    """

    NONE = "nothing"
    PAUSE = "pause"
    RESUME = "resume"
    CLEAR = "clear"
    JOG = "jog"


PHASES, REQUESTS = tuple(Phase), tuple(Request)
DISABLED, IDLE, ACQUIRE, SERVO, HOLD, PAUSED, JOG, FAULT = range(len(PHASES))
_, ASKS_PAUSE, ASKS_RESUME, ASKS_CLEAR, ASKS_JOG = range(len(REQUESTS))
SLOW, HELD, PAUSE, FAULTED = (
    int(Action.SLOW),
    int(Action.HOLD),
    int(Action.PAUSE),
    int(Action.FAULT),
)
ASKED, OVERRUN = Cause.ASKED.place, Cause.OVERRUN.bit


@dataclass(frozen=True)
class Mode:
    """A phase, and why.

    Parameters
    ----------
    phase : Phase
        What the servo is doing.
    cause : Cause
        Why; NONE if all is well.
    since : int
        Since when, ns.
    good : int
        Good frames counted in it.
    asks : Action
        The action that is being taken: in SERVO and ACQUIRE at most SLOW, in JOG always that.
    detail : str
        What a person should know beside the cause's sentence, such as which joint it is.
    """

    phase: Phase = Phase.DISABLED
    cause: Cause = Cause.NONE
    since: int = 0
    good: int = 0
    asks: Action = Action.NONE
    detail: str = ""

    @property
    def words(self) -> str:
        """Phase, cause and way out in words."""
        return self.phase.value if self.cause is Cause.NONE else f"{self.phase.value}: {self.why}"

    @property
    def why(self) -> str:
        """Cause, detail and way out in words; empty if all is well."""
        return self.cause.describe(self.detail)

    @property
    def share(self) -> float:
        """Share of the full speed at which the tool may move."""
        return speed_share(PHASES.index(self.phase), int(self.asks))


class ModeStruct(Struct, source=Mode):
    """A mode in compiled functions."""


class Signs(NamedTuple):
    """What a transition depends on beside the causes.

    Parameters
    ----------
    enabled : bool
        Whether the arm's drive is on.
    seen : bool
        Whether both markers have been seen.
    good : bool
        Whether a new frame came and was accepted in this tick.
    ready : bool
        Whether there is an estimate to servo with.
    """

    enabled: bool
    seen: bool
    good: bool
    ready: bool


@compiled
def speed_share(phase: int, asks: int) -> float:
    """Share of the full speed at which the tool may move."""
    if phase == SERVO and asks < SLOW:
        return 1.0
    return SLOW_SHARE if phase in (SERVO, ACQUIRE, JOG) else 0.0


@compiled
def transition(
    s: ModeStruct, causes: int, signs: Signs, request: int, now: int, t: Thresholds
) -> None:
    """The mode after one tick at `now` ns, with the set of `causes` found; `request` by its place
    in Request. Whatever the causes, more of them never give a softer answer.
    """
    cause = gravest(causes)
    action = ACTIONS[cause]
    if s.phase == FAULT or action == FAULTED:
        fault(s, cause, request, now)
    elif s.phase == DISABLED:
        if signs.enabled:
            s.phase, s.cause, s.since, s.good, s.asks = IDLE, 0, now, 0, 0
    elif request == ASKS_JOG and s.phase in (IDLE, PAUSED, JOG) and not causes & OVERRUN:
        jog(s, now)
    elif action == PAUSE or s.phase in (JOG, PAUSED) or request == ASKS_PAUSE:
        pause(s, cause, request, now)
    elif s.phase == IDLE:
        wait(s, cause, signs, now)
    elif action == HELD:
        hold(s, cause, now, t)
    else:
        go_on(s, cause, signs, now, t)


@compiled
def fault(s: ModeStruct, cause: int, request: int, now: int) -> None:
    """Into FAULT, where the first cause stays; out of it by a person once no cause asks for it any
    more.
    """
    if s.phase != FAULT:
        enter_fault(s, cause, now)
    elif request == ASKS_CLEAR and ACTIONS[cause] < FAULTED:
        s.phase, s.cause, s.since, s.good, s.asks = DISABLED, 0, now, 0, 0


@compiled
def enter_fault(s: ModeStruct, cause: int, now: int) -> None:
    """Enter FAULT."""
    s.phase, s.cause, s.since, s.good, s.asks = FAULT, cause, now, 0, FAULTED


@compiled
def jog(s: ModeStruct, now: int) -> None:
    """Into JOG, or on in it."""
    s.since = s.since if s.phase == JOG else now
    s.phase, s.cause, s.good, s.asks = JOG, 0, 0, SLOW


@compiled
def wait(s: ModeStruct, cause: int, signs: Signs, now: int) -> None:
    """In IDLE, or into ACQUIRE."""
    action = ACTIONS[cause]
    if signs.seen and action < HELD:
        s.phase, s.cause, s.since, s.good, s.asks = ACQUIRE, cause, now, 0, action
    else:
        s.phase, s.cause, s.since, s.good, s.asks = IDLE, cause, s.since, 0, action


@compiled
def pause(s: ModeStruct, cause: int, request: int, now: int) -> None:
    """Into PAUSED, on in it, or out of it by a person; what stands against that is named."""
    why = cause if ACTIONS[cause] == PAUSE else 0
    if s.phase != PAUSED:
        s.phase, s.cause, s.since, s.good, s.asks = PAUSED, graver(why, ASKED), now, 0, PAUSE
    elif request != ASKS_RESUME:
        s.phase, s.cause, s.since, s.good, s.asks = PAUSED, graver(why, s.cause), s.since, 0, PAUSE
    elif ACTIONS[cause] < HELD:
        s.phase, s.cause, s.since, s.good, s.asks = ACQUIRE, 0, now, 0, 0
    else:
        s.phase, s.cause, s.since, s.good, s.asks = PAUSED, cause, s.since, 0, PAUSE


@compiled
def hold(s: ModeStruct, cause: int, now: int, t: Thresholds) -> None:
    """Into HOLD or on in it; after its time into PAUSED."""
    since = s.since if s.phase == HOLD else now
    if now - since > t.hold_time * 1e9:
        s.phase, s.cause, s.since, s.good, s.asks = PAUSED, cause, now, 0, PAUSE
    else:
        s.phase, s.cause, s.since, s.good, s.asks = HOLD, cause, since, 0, HELD


@compiled
def go_on(s: ModeStruct, cause: int, signs: Signs, now: int, t: Thresholds) -> None:
    """From HOLD through ACQUIRE to SERVO, by good frames."""
    good, action = s.good + int(signs.good), ACTIONS[cause]
    if s.phase == HOLD:
        if now - s.since > t.hold_time * 1e9:
            s.phase, s.cause, s.since, s.good, s.asks = PAUSED, s.cause, now, 0, PAUSE
        elif good < t.good_to_recover:
            s.phase, s.cause, s.since, s.good, s.asks = HOLD, s.cause, s.since, good, HELD
        else:
            s.phase, s.cause, s.since, s.good, s.asks = ACQUIRE, cause, now, 0, action
    elif s.phase == ACQUIRE:
        if signs.ready and good >= t.good_to_servo:
            s.phase, s.cause, s.since, s.good, s.asks = SERVO, cause, now, 0, action
        else:
            s.phase, s.cause, s.since, s.good, s.asks = (
                ACQUIRE,
                cause,
                s.since,
                good if signs.ready else 0,
                action,
            )
    elif s.cause != cause or s.asks != action:
        s.phase, s.cause, s.since, s.good, s.asks = SERVO, cause, s.since, 0, action
