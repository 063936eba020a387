"""State machine of the servo: its phases and the transitions between them.

    DISABLED ─► IDLE ─► ACQUIRE ─► SERVO        FAULT ─ clear ─► DISABLED
                 │        ▲  ▲       │          (from every phase, latched)
                 │ resume │  └ HOLD ◄┤
                 │        └─ PAUSED ◄┘
                 └─► JOG ◄─────┘                JOG ends in PAUSED

Every cause requests an action, and the strongest action that is requested is taken. An additional
cause therefore never weakens the reaction. HOLD ramps the rates to zero and recovers by itself.
Only the operator resumes from PAUSED, always into ACQUIRE. FAULT sets the rates to zero at once and
switches the drive off; it ends only with the request `CLEAR` after its causes are gone. In JOG the
operator moves the joints and repeats the request at every tick. JOG needs no image and no estimate:
only a fault or a late loop ends it. The module reads no clock: the time is an argument.
"""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Struct
from rcmservo.safety.causes import ACTIONS, Action, Cause, select_more_severe, select_most_severe
from rcmservo.safety.thresholds import Thresholds

SLOW_SPEED_SCALE = 0.2
"""Fraction of the full speed in ACQUIRE and JOG, and while a cause requests SLOW."""


class Phase(Enum):
    """Phase of the servo; its value describes it for the operator.

    Attributes
    ----------
    DISABLED
        The drive is off.
    IDLE
        The tool stands still until both markers are detected.
    ACQUIRE
        The tool explores, or servoes at a fraction of the full speed.
    SERVO
        The tool servoes to the target.
    HOLD
        The rates are ramped to zero; accepted frames lead to ACQUIRE.
    PAUSED
        The tool stands still until the operator resumes.
    JOG
        The operator moves the joints.
    FAULT
        The rates are zero and the drive is off until the operator clears the fault.
    """

    DISABLED = "drive off"
    IDLE = "waiting for the markers"
    ACQUIRE = "acquiring"
    SERVO = "servoing"
    HOLD = "holding still"
    PAUSED = "paused"
    JOG = "jogged by the operator"
    FAULT = "fault"


class Request(Enum):
    """Request of the operator at a tick.

    Attributes
    ----------
    NONE
        No request.
    PAUSE
        Enter PAUSED.
    RESUME
        Resume from PAUSED into ACQUIRE, unless a cause of a stop is present.
    CLEAR
        Leave FAULT into DISABLED, unless a cause of a fault is present.
    JOG
        Move the joints at requested rates; the request must be repeated at every tick.

    Notes
    -----
    An `Operator` jogs by returning ``Jog(rates)``: `run` raises `BadInput` for ``Request.JOG``,
    which has no rates. `Servo.step` takes ``Request.JOG`` with its argument ``jog``.

    CLEAR has an effect in FAULT only, at any tick at which no cause with the action FAULT is
    present any more. It does not enable the drive. In DISABLED `run` ends: call it once more, with
    the last state, to enable the drive. In a loop of one's own, `Plant.enable` enables it.
    """

    NONE = "nothing"
    PAUSE = "pause"
    RESUME = "resume"
    CLEAR = "clear"
    JOG = "jog"


PHASES, REQUESTS = tuple(Phase), tuple(Request)
DISABLED, IDLE, ACQUIRE, SERVO, HOLD, PAUSED, JOG, FAULT = range(len(PHASES))
_, REQUEST_PAUSE, REQUEST_RESUME, REQUEST_CLEAR, REQUEST_JOG = range(len(REQUESTS))
_, _, ACTION_SLOW, ACTION_HOLD, ACTION_PAUSE, ACTION_FAULT = map(int, Action)
OPERATOR_PAUSE, OVERRUN_BIT = Cause.ASKED.code, Cause.OVERRUN.bit


@dataclass(frozen=True)
class Mode:
    """Phase of the servo and its cause.

    Parameters
    ----------
    phase : Phase
        Phase of the servo.
    cause : Cause
        Cause of the phase; NONE in normal operation.
    since : int
        Time at which the phase began, ns.
    accepted_frames : int
        Number of frames accepted in the phase so far.
    action : Action
        Action that is taken: at most SLOW in SERVO and ACQUIRE, always SLOW in JOG.
    detail : str
        Details for the operator in addition to the cause's sentence, such as the joint and its
        value.

    Notes
    -----
    The property `speed_scale` is the fraction of the joint speed limits ``gate.speed`` that the
    rates may reach: 1 in SERVO, but 0.2 with the action SLOW; 0.2 in ACQUIRE and JOG; 0 in the
    other phases. The value 0.2 is the constant ``SLOW_SPEED_SCALE`` of
    `rcmservo.safety.state_machine`, not a setting.
    """

    phase: Phase = Phase.DISABLED
    cause: Cause = Cause.NONE
    since: int = 0
    accepted_frames: int = 0
    action: Action = Action.NONE
    detail: str = ""

    @property
    def text(self) -> str:
        """Phase, cause, detail and remedy as one text."""
        return f"{self.phase.value}: {self.reason}" if self.reason else self.phase.value

    @property
    def reason(self) -> str:
        """Cause, detail and remedy as one text; empty in normal operation."""
        return self.cause.describe(self.detail)

    @property
    def speed_scale(self) -> float:
        """Fraction of the full speed at which the tool may move."""
        return speed_scale(PHASES.index(self.phase), int(self.action))


class ModeStruct(Struct, source=Mode):
    """Mode, as a row for compiled functions."""


class TransitionInputs(NamedTuple):
    """Conditions of a transition in addition to the causes.

    Parameters
    ----------
    drive_enabled : bool
        True if the arm's drive is on.
    has_accepted_frame : bool
        True if a frame with both markers has been accepted.
    frame_accepted : bool
        True if a new frame arrived and was accepted at this tick.
    has_estimate : bool
        True if the exploration has produced an estimate.
    """

    drive_enabled: bool
    has_accepted_frame: bool
    frame_accepted: bool
    has_estimate: bool


@compiled
def speed_scale(phase: int, action: int) -> float:
    """Return the fraction of the full speed at which the tool may move.

    `phase` is an index of `PHASES`, `action` a value of `Action`.
    """
    if phase == SERVO and action < ACTION_SLOW:
        return 1.0
    return SLOW_SPEED_SCALE if phase in (SERVO, ACQUIRE, JOG) else 0.0


@compiled
def advance_mode(
    mode: ModeStruct,
    causes: int,
    inputs: TransitionInputs,
    request: int,
    now: int,
    thresholds: Thresholds,
) -> None:
    """Advance the mode by one tick.

    An additional cause never leads to a weaker action.

    Parameters
    ----------
    mode : ModeStruct
        Mode of the last tick; overwritten.
    causes : int
        Set of the causes that are present, by their bits.
    inputs : TransitionInputs
        Other conditions.
    request : int
        Request of the operator, as an index of `REQUESTS`.
    now : int
        Time of the tick, ns.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    cause = select_most_severe(causes)
    action = ACTIONS[cause]
    if mode.phase == FAULT or action == ACTION_FAULT:
        handle_fault(mode, cause, request, now)
    elif mode.phase == DISABLED:
        if inputs.drive_enabled:
            set_mode(mode, IDLE, 0, now, 0, 0)
    elif request == REQUEST_JOG and mode.phase in (IDLE, PAUSED, JOG) and not causes & OVERRUN_BIT:
        handle_jog(mode, now)
    elif action == ACTION_PAUSE or mode.phase in (JOG, PAUSED) or request == REQUEST_PAUSE:
        handle_pause(mode, cause, request, now)
    elif mode.phase == IDLE:
        handle_idle(mode, cause, inputs, now)
    elif action == ACTION_HOLD:
        handle_hold(mode, cause, now, thresholds)
    else:
        advance_towards_servo(mode, cause, inputs, now, thresholds)


@compiled
def set_mode(
    mode: ModeStruct, phase: int, cause: int, since: int, accepted_frames: int, action: int
) -> None:
    """Set all fields of the mode."""
    mode.phase, mode.cause, mode.action = phase, cause, action
    mode.since, mode.accepted_frames = since, accepted_frames


@compiled
def handle_fault(mode: ModeStruct, cause: int, request: int, now: int) -> None:
    """Enter FAULT, stay there with its first cause, or leave it at the operator's request.

    The request is refused while a cause of a fault is present.
    """
    if mode.phase != FAULT:
        enter_fault(mode, cause, now)
    elif request == REQUEST_CLEAR and ACTIONS[cause] < ACTION_FAULT:
        set_mode(mode, DISABLED, 0, now, 0, 0)


@compiled
def enter_fault(mode: ModeStruct, cause: int, now: int) -> None:
    """Enter FAULT."""
    set_mode(mode, FAULT, cause, now, 0, ACTION_FAULT)


@compiled
def handle_jog(mode: ModeStruct, now: int) -> None:
    """Enter JOG or stay there."""
    set_mode(mode, JOG, 0, mode.since if mode.phase == JOG else now, 0, ACTION_SLOW)


@compiled
def handle_idle(mode: ModeStruct, cause: int, inputs: TransitionInputs, now: int) -> None:
    """Stay in IDLE, or enter ACQUIRE once a frame with both markers has been accepted."""
    action = ACTIONS[cause]
    if inputs.has_accepted_frame and action < ACTION_HOLD:
        set_mode(mode, ACQUIRE, cause, now, 0, action)
    else:
        set_mode(mode, IDLE, cause, mode.since, 0, action)


@compiled
def handle_pause(mode: ModeStruct, cause: int, request: int, now: int) -> None:
    """Enter PAUSED, stay there, or leave it at the operator's request.

    The mode reports a cause that prevents the resumption.
    """
    pausing_cause = cause if ACTIONS[cause] == ACTION_PAUSE else 0
    if mode.phase != PAUSED:
        entry_cause = select_more_severe(pausing_cause, OPERATOR_PAUSE)
        set_mode(mode, PAUSED, entry_cause, now, 0, ACTION_PAUSE)
    elif request != REQUEST_RESUME:
        worst_cause = select_more_severe(pausing_cause, mode.cause)
        set_mode(mode, PAUSED, worst_cause, mode.since, 0, ACTION_PAUSE)
    elif ACTIONS[cause] < ACTION_HOLD:
        set_mode(mode, ACQUIRE, 0, now, 0, 0)
    else:
        set_mode(mode, PAUSED, cause, mode.since, 0, ACTION_PAUSE)


@compiled
def handle_hold(mode: ModeStruct, cause: int, now: int, thresholds: Thresholds) -> None:
    """Enter HOLD or stay there; enter PAUSED after `hold_time`."""
    since = mode.since if mode.phase == HOLD else now
    if now - since > thresholds.hold_time * 1e9:
        set_mode(mode, PAUSED, cause, now, 0, ACTION_PAUSE)
    else:
        set_mode(mode, HOLD, cause, since, 0, ACTION_HOLD)


@compiled
def advance_towards_servo(
    mode: ModeStruct, cause: int, inputs: TransitionInputs, now: int, thresholds: Thresholds
) -> None:
    """Advance from HOLD through ACQUIRE to SERVO by counting accepted frames."""
    action = ACTIONS[cause]
    accepted_frames = mode.accepted_frames + int(inputs.frame_accepted)
    if mode.phase == HOLD:
        if now - mode.since > thresholds.hold_time * 1e9:
            set_mode(mode, PAUSED, mode.cause, now, 0, ACTION_PAUSE)
        elif accepted_frames < thresholds.frames_to_recover:
            set_mode(mode, HOLD, mode.cause, mode.since, accepted_frames, ACTION_HOLD)
        else:
            set_mode(mode, ACQUIRE, cause, now, 0, action)
    elif mode.phase == ACQUIRE:
        counted_frames = accepted_frames if inputs.has_estimate else 0
        if inputs.has_estimate and accepted_frames >= thresholds.frames_to_servo:
            set_mode(mode, SERVO, cause, now, 0, action)
        else:
            set_mode(mode, ACQUIRE, cause, mode.since, counted_frames, action)
    elif mode.cause != cause or mode.action != action:
        set_mode(mode, SERVO, cause, mode.since, 0, action)
