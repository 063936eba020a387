"""What the servo may do and why: its phases, the causes that stop it, and the function that leads
from phase to phase.

    DISABLED ─► IDLE ─► ACQUIRE ─► SERVO        FAULT ─ clear ─► DISABLED
                          ▲  ▲       │          (from everywhere, latched)
                   resume │  └ HOLD ◄┤
                          └─ PAUSED ◄┘

Every cause asks for an action, and the greatest of those present wins, so that one more fault never
softens the answer. HOLD ramps to zero and recovers by itself; from PAUSED only a person resumes,
always into ACQUIRE; FAULT is zero at once with the drive off, and only `CLEAR` with its causes gone
leads out of it. No clock here: the time is an argument.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum
from functools import cache

HOLD_TIME = 1_000_000_000
"""ns of HOLD after which only a person resumes."""

GOOD_TO_RECOVER = 5
"""New good frames that end a HOLD."""

GOOD_TO_SERVO = 10
"""New good frames in ACQUIRE, with the estimate at hand, before SERVO."""

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


class Action(IntEnum):
    """What a cause asks for; the greatest wins."""

    NONE = 0
    WARN = 1
    SLOW = 2
    HOLD = 3
    PAUSE = 4
    FAULT = 5


class Request(Enum):
    """What a person asks for: nothing, a pause, to go on after one, or to leave a fault."""

    NONE = "nothing"
    PAUSE = "pause"
    RESUME = "resume"
    CLEAR = "clear"


class Cause(Enum):
    """Why the tool is not simply on its way. Its value is a sentence for a person; ``action`` is
    what it asks for and ``way_out`` what a person can do about it. Of equal ones the one that
    stands first here is named."""

    action: Action
    way_out: str

    def __new__(cls, sentence: str, action: Action, way_out: str) -> "Cause":
        cause = object.__new__(cls)
        cause._value_, cause.action, cause.way_out = sentence, action, way_out
        return cause

    NONE = "", Action.NONE, ""

    NOT_FINITE = (
        "a number that is not finite reached the last gate",
        Action.FAULT,
        "this is an error in the software: keep the record, clear, and enable again",
    )
    ESTIMATOR_FAILED = (
        "the estimator raised an error, or gave what is no Jacobian",
        Action.FAULT,
        "mend the estimator and begin a new run",
    )
    ESTIMATE_NOT_FINITE = (
        "the estimator gave a number that is not finite",
        Action.FAULT,
        "this is an error in the estimator: keep the record, clear, and enable again",
    )
    JOINTS_NOT_FINITE = (
        "the arm tells joints that are not finite",
        Action.FAULT,
        "check the encoders, then clear and enable again",
    )
    DRIVE_OFF = (
        "the arm's drive went off: its watchdog or an emergency stop has switched it off",
        Action.FAULT,
        "find out what stopped it, then clear and enable again",
    )
    ARM_SILENT = (
        "the arm has not answered for too long",
        Action.FAULT,
        "check the arm's connection, then clear and enable again",
    )
    NOT_FOLLOWING = (
        "the joints do not follow the commands",
        Action.FAULT,
        "look for a blocked, slipping or wrongly wired axis, then clear and enable again",
    )
    BEYOND_LIMIT = (
        "a joint is beyond its limit",
        Action.FAULT,
        "bring the tool back by hand, then clear and enable again",
    )

    CAMERA_MOVED = (
        "the markers jumped while the joints did not: the camera was moved",
        Action.PAUSE,
        "show the target again in the new view, then resume: the servo explores anew",
    )
    SWAPPED = (
        "the markers are taken for each other",
        Action.PAUSE,
        "see that nothing else looks like a marker, and that marker 1 is the one nearer the RCM, "
        "then resume",
    )
    SURPRISED = (
        "the markers are not where the tool's motion puts them: something else is taken for one, "
        "or the camera moved",
        Action.PAUSE,
        "see that nothing else looks like a marker, then resume",
    )
    DIVERGED = (
        "the markers keep moving otherwise than the estimate says",
        Action.PAUSE,
        "check that the tool is rigid and the arm tells its joints rightly, then resume: the "
        "servo explores anew",
    )
    OVERRUN = (
        "the loop ran late: three ticks in a row, or one by more than its bound",
        Action.PAUSE,
        "take other work off this computer, then resume",
    )
    NOT_RECORDED = (
        "the record can no longer be written",
        Action.PAUSE,
        "make room on the disk and start a new run",
    )
    NO_ROOM = (
        "the joint limits leave no room to explore around the start",
        Action.PAUSE,
        "bring the tool further from its limits, then resume",
    )
    NOT_EXPLORED = (
        "exploration ended without an estimate that predicts what the camera sees",
        Action.PAUSE,
        "check mechanism and tool in the rig file, or allow a larger exploration, then resume",
    )
    STALLED = (
        "the feature error has stopped falling: the target cannot be reached from here",
        Action.PAUSE,
        "bring the tool to another start, or show a target within reach, then resume",
    )
    TARGET_OLD = (
        "the target was shown before the camera was moved",
        Action.PAUSE,
        "show the target again, then resume",
    )
    ASKED = "a person asked for a pause", Action.PAUSE, "resume when ready"

    MARKERS_LOST = (
        "neither marker is seen: they left the picture or are hidden",
        Action.HOLD,
        "clear the view, then resume",
    )
    MARKER_1_LOST = (
        "marker 1 is not seen: it left the picture or is hidden",
        Action.HOLD,
        "clear the view, then resume",
    )
    MARKER_2_LOST = (
        "marker 2 is not seen: it left the picture or is hidden",
        Action.HOLD,
        "clear the view, then resume",
    )
    FRAMES_DAMAGED = (
        "frames come damaged",
        Action.HOLD,
        "check the camera and its cable, then resume",
    )
    FRAMES_NOT_NEW = (
        "frames come repeated or out of order",
        Action.HOLD,
        "check the camera's driver, then resume",
    )
    FRAMES_CLOCK = (
        "frames bear times that cannot be right",
        Action.HOLD,
        "check the camera's clock, then resume",
    )
    STALE = (
        "no new frame has come from the camera for too long",
        Action.HOLD,
        "check the camera, then resume",
    )
    LATE = (
        "the frames come too long after their exposure",
        Action.HOLD,
        "make camera and tracking faster, then resume",
    )
    JOINTS_UNKNOWN = (
        "the joints' positions at the exposure of the frame are not known",
        Action.HOLD,
        "check that camera and arm keep the same time, then resume",
    )
    RCM_UNKNOWN = (
        "the imaged RCM cannot be computed: the lines seen of the tool are too much alike",
        Action.HOLD,
        "turn the camera so that the tool is not seen from its end, then resume",
    )
    ESTIMATE_LARGE = (
        "the estimate is out of bounds: no camera sees a tool move so fast",
        Action.HOLD,
        "resume: the servo explores anew",
    )
    SINGULAR = (
        "the target lies at or beyond a singular surface: the scaled Jacobian's condition passed "
        "its limit",
        Action.HOLD,
        "bring the tool nearer to the target or away from the singular pose, then resume",
    )
    JOINT_1_LIMIT = (
        "the way to the target goes past the limit of joint 1",
        Action.HOLD,
        "bring the tool to another start, then resume",
    )
    JOINT_2_LIMIT = (
        "the way to the target goes past the limit of joint 2",
        Action.HOLD,
        "bring the tool to another start, then resume",
    )
    JOINT_3_LIMIT = (
        "the way to the target goes past the limit of joint 3",
        Action.HOLD,
        "bring the tool to another start, then resume",
    )

    REJECTED = (
        "a frame was not believed: the markers are not where the tool's motion puts them",
        Action.SLOW,
        "",
    )
    AGEING = "no new frame has come for one and a half frame periods", Action.SLOW, ""
    NEARLY_SINGULAR = "the scaled Jacobian's condition is near its limit", Action.SLOW, ""

    LATE_TICK = "the loop ran late by a tick", Action.WARN, ""

    @property
    def words(self) -> str:
        """The sentence and the way out, as one text."""
        return self.told("")

    def told(self, detail: str) -> str:
        """The sentence, what a person should know beside it, and the way out, as one text."""
        sentence = f"{self.value}: {detail}" if detail else self.value
        return f"{sentence} ({self.way_out})" if self.way_out else sentence

    @property
    def bit(self) -> int:
        """Its bit in a set of causes that is kept as one number; 0 for NONE."""
        return BITS[self]


BITS = {cause: (1 << place) >> 1 for place, cause in enumerate(Cause)}
ORDER = {cause: (cause.action, -place) for place, cause in enumerate(Cause)}


def gravest(causes: Iterable[Cause]) -> Cause:
    """The cause with the greatest action, the one listed first of equal ones; NONE where there is
    none."""
    return max(causes, key=ORDER.__getitem__, default=Cause.NONE)


@cache
def gravest_of(bits: int) -> Cause:
    """The gravest of the causes whose bits are set."""
    return gravest(cause for cause in Cause if cause.bit & bits)


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


@dataclass(frozen=True)
class Signs:
    """What a transition depends on beside the causes.

    ``enabled``, whether the arm's drive is on; ``seen``, whether both markers have been seen;
    ``good``, whether a new frame came and was accepted in this tick; ``ready``, whether there is an
    estimate to servo with.
    """

    enabled: bool
    seen: bool
    good: bool
    ready: bool


def transition(
    mode: Mode, causes: Iterable[Cause], signs: Signs, request: Request, now: int
) -> Mode:
    """The mode after one tick at `now` ns. Pure; whatever the causes, more of them never give a
    softer answer."""
    cause = gravest(causes)
    if mode.phase is Phase.FAULT or cause.action is Action.FAULT:
        return _fault(mode, cause, request, now)
    if mode.phase is Phase.DISABLED:
        return Mode(Phase.IDLE, since=now) if signs.enabled else mode
    if cause.action is Action.PAUSE or mode.phase is Phase.PAUSED or request is Request.PAUSE:
        return _paused(mode, cause, request, now)
    if mode.phase is Phase.IDLE:
        return _waiting(mode, cause, signs, now)
    return (
        _held(mode, cause, now) if cause.action is Action.HOLD else _onward(mode, cause, signs, now)
    )


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


def _held(mode: Mode, cause: Cause, now: int) -> Mode:
    since = mode.since if mode.phase is Phase.HOLD else now
    if now - since > HOLD_TIME:
        return Mode(Phase.PAUSED, cause, now, asks=Action.PAUSE)
    return Mode(Phase.HOLD, cause, since, asks=Action.HOLD)


def _onward(mode: Mode, cause: Cause, signs: Signs, now: int) -> Mode:
    """From HOLD through ACQUIRE to SERVO, by good frames."""
    good = mode.good + signs.good
    if mode.phase is Phase.HOLD:
        if now - mode.since > HOLD_TIME:
            return Mode(Phase.PAUSED, mode.cause, now, asks=Action.PAUSE)
        if good < GOOD_TO_RECOVER:
            return Mode(Phase.HOLD, mode.cause, mode.since, good, Action.HOLD)
        return Mode(Phase.ACQUIRE, cause, now, asks=cause.action)
    if mode.phase is Phase.ACQUIRE:
        if signs.ready and good >= GOOD_TO_SERVO:
            return Mode(Phase.SERVO, cause, now, asks=cause.action)
        return Mode(Phase.ACQUIRE, cause, mode.since, good if signs.ready else 0, cause.action)
    same = mode.cause is cause
    return mode if same else Mode(Phase.SERVO, cause, mode.since, asks=cause.action)
