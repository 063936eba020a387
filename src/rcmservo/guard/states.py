"""What the servo may do: its phases, and the function that leads from phase to phase.

    DISABLED ─► IDLE ─► ACQUIRE ─► SERVO        FAULT ─ clear ─► DISABLED
                          ▲  ▲       │          (from everywhere, latched)
                   resume │  └ HOLD ◄┤
                          └─ PAUSED ◄┘

Every cause asks for an action, and the greatest of those present wins, so that one more fault never
softens the answer. HOLD ramps to zero and recovers by itself; from PAUSED only a person resumes,
always into ACQUIRE; FAULT is zero at once with the drive off, and only `CLEAR` with its causes gone
leads out of it. No clock here: the time is an argument.
"""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from rcmservo.guard.causes import ORDER, Action, Cause, gravest, gravest_of
from rcmservo.guard.thresholds import Thresholds

SLOW_SHARE = 0.2
"""Share of the full speed in ACQUIRE, and while a cause asks for SLOW."""


class Phase(Enum):
    """What the servo is doing."""

    DISABLED = "drive off"
    IDLE = "waiting for the markers"
    ACQUIRE = "acquiring"
    SERVO = "servoing"
    HOLD = "holding still"
    PAUSED = "paused"
    FAULT = "fault"


class Request(Enum):
    """What a person asks for: nothing, a pause, to go on after one, or to leave a fault."""

    NONE = "nothing"
    PAUSE = "pause"
    RESUME = "resume"
    CLEAR = "clear"


@dataclass(frozen=True)
class Mode:
    """A phase, and why."""

    phase: Phase = Phase.DISABLED
    """What the servo is doing."""
    cause: Cause = Cause.NONE
    """Why; NONE if all is well."""
    since: int = 0
    """Since when, ns."""
    good: int = 0
    """Good frames counted in it."""
    asks: Action = Action.NONE
    """The action that is being taken: in SERVO and ACQUIRE at most SLOW."""
    detail: str = ""
    """What a person should know beside the cause's sentence, such as which joint it is."""

    @property
    def words(self) -> str:
        """Phase, cause and way out in words."""
        return self.phase.value if self.cause is Cause.NONE else f"{self.phase.value}: {self.why}"

    @property
    def why(self) -> str:
        """Cause, detail and way out in words; empty if all is well."""
        return self.cause.told(self.detail)

    @property
    def share(self) -> float:
        """Share of the full speed at which the tool may move."""
        if self.phase is Phase.SERVO and self.asks < Action.SLOW:
            return 1.0
        return SLOW_SHARE if self.phase in (Phase.SERVO, Phase.ACQUIRE) else 0.0


class Signs(NamedTuple):
    """What a transition depends on beside the causes."""

    enabled: bool
    """Whether the arm's drive is on."""
    seen: bool
    """Whether both markers have been seen."""
    good: bool
    """Whether a new frame came and was accepted in this tick."""
    ready: bool
    """Whether there is an estimate to servo with."""


def transition(
    mode: Mode, causes: int, signs: Signs, request: Request, now: int, t: Thresholds
) -> Mode:
    """The mode after one tick at `now` ns, with the set of `causes` found. Pure; whatever the
    causes, more of them never give a softer answer."""
    cause = gravest_of(causes)
    if mode.phase is Phase.FAULT or cause.action is Action.FAULT:
        return _fault(mode, cause, request, now)
    if mode.phase is Phase.DISABLED:
        return Mode(Phase.IDLE, since=now) if signs.enabled else mode
    if cause.action is Action.PAUSE or mode.phase is Phase.PAUSED or request is Request.PAUSE:
        return _paused(mode, cause, request, now)
    if mode.phase is Phase.IDLE:
        return _waiting(mode, cause, signs, now)
    if cause.action is Action.HOLD:
        return _held(mode, cause, now, t)
    return _onward(mode, cause, signs, now, t)


def _fault(mode: Mode, cause: Cause, request: Request, now: int) -> Mode:
    """Into FAULT, where the first cause stays; out of it by a person once no cause asks for it any
    more."""
    if mode.phase is not Phase.FAULT:
        return Mode(Phase.FAULT, cause, now, asks=Action.FAULT)
    cleared = request is Request.CLEAR and cause.action < Action.FAULT
    return Mode(Phase.DISABLED, since=now) if cleared else mode


def _waiting(mode: Mode, cause: Cause, signs: Signs, now: int) -> Mode:
    if signs.seen and cause.action < Action.HOLD:
        return Mode(Phase.ACQUIRE, cause, now, asks=cause.action)
    return Mode(Phase.IDLE, cause, mode.since, asks=cause.action)


def _paused(mode: Mode, cause: Cause, request: Request, now: int) -> Mode:
    """Into PAUSED, on in it, or out of it by a person; what stands against that is named."""
    why = cause if cause.action is Action.PAUSE else Cause.NONE
    if mode.phase is not Phase.PAUSED:
        return Mode(Phase.PAUSED, gravest((why, Cause.ASKED)), now, asks=Action.PAUSE)
    if request is Request.RESUME:
        if cause.action < Action.HOLD:
            return Mode(Phase.ACQUIRE, since=now)
        return Mode(Phase.PAUSED, cause, mode.since, asks=Action.PAUSE)
    return Mode(
        Phase.PAUSED,
        why if ORDER[why] > ORDER[mode.cause] else mode.cause,
        mode.since,
        asks=Action.PAUSE,
    )


def _held(mode: Mode, cause: Cause, now: int, t: Thresholds) -> Mode:
    since = mode.since if mode.phase is Phase.HOLD else now
    if now - since > t.hold_time * 1e9:
        return Mode(Phase.PAUSED, cause, now, asks=Action.PAUSE)
    return Mode(Phase.HOLD, cause, since, asks=Action.HOLD)


def _onward(mode: Mode, cause: Cause, signs: Signs, now: int, t: Thresholds) -> Mode:
    """From HOLD through ACQUIRE to SERVO, by good frames."""
    good = mode.good + signs.good
    if mode.phase is Phase.HOLD:
        if now - mode.since > t.hold_time * 1e9:
            return Mode(Phase.PAUSED, mode.cause, now, asks=Action.PAUSE)
        if good < t.good_to_recover:
            return Mode(Phase.HOLD, mode.cause, mode.since, good, Action.HOLD)
        return Mode(Phase.ACQUIRE, cause, now, asks=cause.action)
    if mode.phase is Phase.ACQUIRE:
        if signs.ready and good >= t.good_to_servo:
            return Mode(Phase.SERVO, cause, now, asks=cause.action)
        return Mode(Phase.ACQUIRE, cause, mode.since, good if signs.ready else 0, cause.action)
    same = mode.cause is cause
    return mode if same else Mode(Phase.SERVO, cause, mode.since, asks=cause.action)
