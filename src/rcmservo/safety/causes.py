"""Causes of stops, slow motion and warnings.

`Cause` declares each cause once: the action that it requests, its sentence and remedy for the
operator, the function that detects it, and the state that it invalidates. Compiled functions know a
cause by its code, and a set of causes as an integer with one bit for each.

To add a cause: write its detector, a compiled function of the facts of a tick, in checks/; declare
its limits as fields of `Thresholds` in thresholds.py; and add a member to `Cause` at the position
of its severity. Then docs/make_fault_table.py renews the table in docs/faults.md.
"""

import inspect
import textwrap
from collections.abc import Callable
from enum import Enum, IntEnum
from functools import partial
from typing import Any, NamedTuple

from rcmservo.numerics.jit import compiled, declare_in
from rcmservo.safety.checks import (
    devices,
    drift,
    estimate,
    exploration,
    markers,
    path,
    repeated_frames,
    singularity,
)
from rcmservo.safety.checks.facts import DetailFacts, TickFacts
from rcmservo.safety.checks.target_explanations import describe_contradiction

TEACH_AGAIN = "teach the target again"
"""Part of a remedy: the operator moves the tool to the target, whose image is stored once more."""


class Action(IntEnum):
    """Action that a cause requests, from the weakest to the strongest.

    If several causes are present, the strongest action is taken.

    Attributes
    ----------
    NONE
        No action.
    WARN
        Report the cause.
    SLOW
        Move at a fifth of the full speed, the joint speed limits ``gate.speed``.
    HOLD
        Ramp the rates to zero; resume automatically once the cause is gone.
    PAUSE
        Ramp the rates to zero; resume only at the operator's request.
    FAULT
        Set the rates to zero at once and switch the drive off, until the operator clears the fault.
    """

    NONE = 0
    WARN = 1
    SLOW = 2
    HOLD = 3
    PAUSE = 4
    FAULT = 5


class Invalidates(IntEnum):
    """State that a pause or fault invalidates.

    The newest accepted frame always stays valid. The first frame after the pause is compared with
    it, which detects a camera that was moved during the pause.

    Attributes
    ----------
    NOTHING
        All state stays valid.
    ESTIMATE
        The estimated Jacobian and imaged RCM: the exploration is repeated.
    ESTIMATE_AND_TARGETS
        In addition all taught targets, because the camera was moved.
    """

    NOTHING = 0
    ESTIMATE = 1
    ESTIMATE_AND_TARGETS = 2


class Declaration(NamedTuple):
    """Declaration of a cause.

    Parameters
    ----------
    action : Action
        Action that the cause requests.
    sentence : str
        Description for the operator.
    remedy : str
        Remedy for the operator; empty if the cause stops nothing.
    detector : Callable[[TickFacts], bool] or None
        Compiled function that detects the cause at a tick; None if the gate or the state machine
        reports it.
    invalidates : Invalidates
        State that the cause invalidates.
    invalidates_unexplored : Invalidates
        State that the cause invalidates before an exploration is done, if that is more.
    hides_markers : bool
        True if the cause explains why no marker is detected.
    detail : Callable[[DetailFacts], str]
        Function that describes the details for the operator, such as the joint, its value and its
        limit; by default there are none.
    """

    action: Action
    sentence: str
    remedy: str = ""
    detector: Callable[[TickFacts], bool] | None = None
    invalidates: Invalidates = Invalidates.NOTHING
    invalidates_unexplored: Invalidates = Invalidates.NOTHING
    hides_markers: bool = False
    detail: Callable[[DetailFacts], str] = lambda facts: ""


warn, slow, hold, pause, fault = (partial(Declaration, action) for action in list(Action)[1:])
"""Functions that declare a cause of each action."""


class Cause(Enum):
    """Cause of a stop, of slow motion or of a warning.

    The value of a member is the sentence for the operator. The members are ordered by severity, the
    most severe first. If several causes are present, the first one is reported. `Thresholds` holds
    the values from which on a cause is present. The entry of a member below states its action, its
    sentence and, in parentheses, its remedy.

    Attributes
    ----------
    declared : Declaration
        Declaration of the cause, a named tuple of `rcmservo.safety.causes`: in addition to action,
        sentence and remedy it has the function that detects the cause and what it invalidates.
    action : Action
        Action that the cause requests.
    remedy : str
        Remedy for the operator; empty if the tool does not stop.
    code : int
        Position among the members, the code of the cause in compiled functions; 0 for NONE.
    bit : int
        Bit of the cause in a set of causes that is stored as one integer; 0 for NONE.
    """

    # the section Attributes is completed with all members below the class

    declared: Declaration
    action: Action
    remedy: str
    code: int
    bit: int

    def __new__(cls, *declaration: Any) -> "Cause":
        """Return a member; the enumeration passes its declaration, a tuple, as arguments."""
        cause = object.__new__(cls)
        cause.declared = Declaration(*declaration)
        cause.action, cause._value_, cause.remedy, *_ = cause.declared
        cause.code = len(cls.__members__)
        cause.bit = (1 << cause.code) >> 1
        return cause

    NONE = Declaration(Action.NONE, "")
    NOT_FINITE = fault(
        "the safety gate received a number that is not finite",
        "this is a software error: keep the record, then clear and enable again",
        invalidates=Invalidates.ESTIMATE,
    )
    ESTIMATOR_FAILED = fault(
        "the estimator raised an error or returned an invalid Jacobian",
        "correct the estimator and start a new run",
        estimate.estimator_failed,
        invalidates=Invalidates.ESTIMATE,
    )
    ESTIMATE_NOT_FINITE = fault(
        "the estimator returned a number that is not finite",
        "this is an error in the estimator: keep the record, then clear and enable again",
        estimate.estimate_is_not_finite,
        invalidates=Invalidates.ESTIMATE,
    )
    JOINTS_NOT_FINITE = fault(
        "the arm reports joint positions that are not finite",
        "check the encoders, then clear and enable again",
        devices.joints_are_not_finite,
        detail=devices.describe_not_finite,
    )
    CLOCK_STOOD = fault(
        "the loop's clock stopped or went back",
        "correct the clock, then clear and enable again",
        devices.clock_did_not_advance,
    )
    DRIVE_OFF = fault(
        "the arm's drive is off: its watchdog or an emergency stop has switched it off",
        "find out why the drive was switched off, then clear and enable again",
        devices.drive_went_off,
    )
    ARM_SILENT = fault(
        "the arm has not answered for too long",
        "check the arm's connection, then clear and enable again",
        devices.arm_is_silent,
    )
    NOT_FOLLOWING = fault(
        "the joints do not follow the commands",
        "look for an axis that is blocked, slips or has its wires reversed, or set "
        "thresholds.drive_lag for slow drives, then clear and enable again",
        devices.joints_do_not_follow,
        detail=devices.describe_following,
    )
    CREEPS = fault(
        "the joints move although no motion is commanded",
        "find out what moves the joints, such as a slipping brake, an offset of the drive or a "
        "hand, then clear and enable again",
        devices.joints_creep,
        detail=devices.describe_creeping,
    )
    BEYOND_LIMIT = fault(
        "a joint is beyond its limit",
        "move the tool back by hand, then clear and enable again",
        devices.joint_is_beyond_limit,
        detail=devices.describe_limits,
    )
    CAMERA_MOVED = pause(
        "the markers jumped while the joints did not: the camera was moved",
        f"{TEACH_AGAIN} in the new view, then resume: the servo repeats the exploration",
        markers.camera_moved,
        invalidates=Invalidates.ESTIMATE_AND_TARGETS,
    )
    SWAPPED = pause(
        "marker 1 and marker 2 are confused with each other",
        "check that nothing else looks like a marker and that marker 1 is the one nearer the RCM, "
        "then resume",
        markers.markers_are_swapped,
        invalidates_unexplored=Invalidates.ESTIMATE,
    )
    STANDS_STILL = pause(
        "the tool moves, but a marker does not: another object is detected as a marker",
        "cover or remove what looks like a marker, then resume",
        markers.markers_stand_still,
        invalidates=Invalidates.ESTIMATE,
        detail=markers.describe_still_markers,
    )
    SURPRISED = pause(
        "the markers are not at the predicted positions: another object is detected as a "
        "marker, the camera moved, or a joint no longer moves the tool",
        "check that nothing else looks like a marker and that each joint moves the tool, then "
        "resume",
        markers.markers_are_unexpected,
        invalidates_unexplored=Invalidates.ESTIMATE_AND_TARGETS,
    )
    FROZEN = pause(
        "the image does not change while the tool moves",
        "restart the camera's image stream, then resume",
        repeated_frames.image_is_frozen,
    )
    DRIFTS = pause(
        "the markers drift away from the positions that the joints predict: the camera moves, "
        "turns or zooms, an object that slides along is detected as the markers, or a joint no "
        "longer moves the tool",
        f"check that the camera is fixed and each joint moves the tool, {TEACH_AGAIN}, then "
        "resume: the servo repeats the exploration",
        drift.markers_drift,
        invalidates=Invalidates.ESTIMATE_AND_TARGETS,
    )
    IMPLAUSIBLE = pause(
        "the camera does not show the joints of teaching at the pixels of the target",
        f"compare the live image with the taught one, {TEACH_AGAIN}, then resume: the servo "
        "repeats the exploration",
        path.target_is_implausible,
        invalidates=Invalidates.ESTIMATE,
        detail=describe_contradiction,
    )
    ELSEWHERE = pause(
        "the image shows the tool at the target, but the joints contradict it: a pose beyond a "
        "singular surface looks the same, the camera was moved or zoomed after the target was "
        "taught, a marker was mistaken, the zero positions of the arm have changed, or a joint no "
        "longer moves the tool",
        f"{TEACH_AGAIN}, then resume",
        path.joints_contradict_image,
        detail=describe_contradiction,
    )
    DIVERGED = pause(
        "the markers repeatedly move differently from the estimate's prediction",
        "check that the tool is rigid and the arm reports correct joint positions, then resume: "
        "the servo repeats the exploration",
        estimate.estimate_diverged,
        invalidates=Invalidates.ESTIMATE,
    )
    OVERRUN = pause(
        "the loop ran late: several ticks in succession, or one tick by more than the limit",
        "stop other programs on this computer, then resume",
        devices.loop_overran,
    )
    NOT_RECORDED = pause(
        "the record cannot be written any more",
        "free disk space and start a new run",
        devices.recording_failed,
    )
    NO_ROOM = pause(
        "the joint limits leave no room for the exploration around the start",
        "move the tool away from its joint limits, then resume",
        exploration.no_room_to_explore,
    )
    NOT_EXPLORED = pause(
        "the exploration ended without an estimate that predicts the camera's images",
        "check mechanism, tool and exposure times, or allow a larger exploration, then resume",
        exploration.exploration_failed,
        invalidates=Invalidates.ESTIMATE,
        detail=exploration.describe_missing_estimate,
    )
    STALLED = pause(
        "the feature error does not decrease any more: the target cannot be reached from this pose",
        "move the tool to another start, or teach a target within reach, then resume",
        path.progress_stalled,
    )
    TARGET_OLD = pause(
        "the target was taught before the camera was moved",
        f"{TEACH_AGAIN}, then resume",
        path.target_is_old,
    )
    ASKED = pause("the operator requested a pause", "resume when ready")
    MARKERS_LOST = hold(
        "neither marker is detected: both left the image or are hidden",
        "clear the camera's view, then resume",
        markers.both_markers_are_lost,
        hides_markers=True,
    )
    MARKER_1_LOST = hold(
        "marker 1 is not detected: it left the image or is hidden",
        "clear the camera's view, then resume",
        markers.marker_1_is_lost,
        hides_markers=True,
    )
    MARKER_2_LOST = hold(
        "marker 2 is not detected: it left the image or is hidden",
        "clear the camera's view, then resume",
        markers.marker_2_is_lost,
        hides_markers=True,
    )
    FRAMES_DAMAGED = hold(
        "the frames arrive damaged",
        "check the camera and its cable, then resume",
        devices.frames_are_damaged,
        hides_markers=True,
    )
    FRAMES_NOT_NEW = hold(
        "the frames arrive repeatedly or out of order",
        "check the camera's driver, then resume",
        devices.frames_are_not_new,
        hides_markers=True,
    )
    FRAMES_CLOCK = hold(
        "the frames have impossible timestamps",
        "check the camera's clock, then resume",
        devices.frame_times_are_invalid,
        hides_markers=True,
    )
    STALE = hold(
        "no new frame has arrived from the camera for too long",
        "check the camera, then resume",
        devices.frames_stopped,
        hides_markers=True,
    )
    LATE = hold(
        "the frames arrive too long after their exposure",
        "reduce the delay of camera and tracking, then resume",
        devices.frames_come_late,
    )
    JOINTS_UNKNOWN = hold(
        "the joint positions at the exposure of the frame are not known",
        "check that the clocks of camera and arm agree, then resume",
        devices.joints_at_exposure_are_unknown,
    )
    RCM_UNKNOWN = hold(
        "the imaged RCM cannot be computed: the imaged lines of the tool are nearly the same",
        "turn the camera so that it does not look along the tool, then resume",
        estimate.rcm_is_unknown,
    )
    ESTIMATE_LARGE = hold(
        "the estimate is out of bounds: no camera images a tool that large",
        "resume: the servo repeats the exploration",
        estimate.estimate_is_large,
        invalidates=Invalidates.ESTIMATE,
    )
    SINGULAR = hold(
        "the target lies at or beyond a singular surface: by the estimate, no motion of the tool "
        "reduces the feature error",
        "move the tool nearer to the target or away from the singular pose, then resume",
        singularity.path_is_singular,
    )
    JOINT_1_LIMIT = hold(
        "the path to the target passes the limit of joint 1",
        "move the tool to another start, then resume",
        path.joint_1_blocks_the_path,
    )
    JOINT_2_LIMIT = hold(
        "the path to the target passes the limit of joint 2",
        "move the tool to another start, then resume",
        path.joint_2_blocks_the_path,
    )
    JOINT_3_LIMIT = hold(
        "the path to the target passes the limit of joint 3",
        "move the tool to another start, then resume",
        path.joint_3_blocks_the_path,
    )
    REJECTED = slow(
        "a frame was rejected: the markers are not at the predicted positions",
        detector=markers.frame_was_rejected,
    )
    WITHOUT_MARKER_1 = slow(
        "marker 1 is not detected: marker 2 and the joints determine the pose",
        detector=markers.marker_1_is_completed,
    )
    WITHOUT_MARKER_2 = slow(
        "marker 2 is not detected: marker 1 and the joints determine the pose",
        detector=markers.marker_2_is_completed,
    )
    AGEING = slow("no new frame has arrived for longer than usual", detector=devices.frame_is_old)
    NEARLY_SINGULAR = slow(
        "the path to the target is nearly singular", detector=singularity.path_is_nearly_singular
    )
    TARGET_UNCHECKED = slow(
        "the target has no joints: only the image shows whether the tool moves to the right place",
        detector=path.target_is_unchecked,
    )
    LATE_TICK = warn("the loop ran late by a tick", detector=devices.tick_came_late)

    @property
    def needs_teaching(self) -> bool:
        """True if the remedy includes teaching the target again."""
        return TEACH_AGAIN in self.remedy

    @property
    def text(self) -> str:
        """Sentence and remedy as one text."""
        return self.describe("")

    def describe(self, detail: str) -> str:
        """Return "sentence: detail (remedy)", without the parts that are empty."""
        sentence = f"{self.value}: {detail}" if detail else self.value
        return f"{sentence} ({self.remedy})" if self.remedy else sentence

    @property
    def stop_sentence(self) -> str:
        """Sentence of a cause that stops the tool; empty for other causes."""
        return self.value if self.action >= Action.HOLD else ""


def _describe_member(cause: Cause) -> str:
    """Return the entry of a cause in the section Attributes of `Cause`."""
    description = f"{cause.action.name}: {cause.text or 'normal operation'}."
    return f"\n{cause.name}\n" + textwrap.indent(textwrap.fill(description, 92), "    ")


Cause.__doc__ = inspect.cleandoc(Cause.__doc__ or "") + "".join(map(_describe_member, Cause)) + "\n"

EXPLAINED_BY_MOTION = frozenset(
    {
        Cause.CAMERA_MOVED,
        Cause.SURPRISED,
        Cause.DRIFTS,
        Cause.IMPLAUSIBLE,
        Cause.ELSEWHERE,
        Cause.DIVERGED,
        Cause.NOT_EXPLORED,
    }
)
"""Causes that a motion of the port or of the camera may have."""

EXPLAINED_BY_ARM = EXPLAINED_BY_MOTION - {Cause.CAMERA_MOVED, Cause.NOT_EXPLORED}
"""Causes that errors of arm, tool and lens may have."""

EXPLAINED_BY_REPORTS = EXPLAINED_BY_MOTION | {
    Cause.NOT_FOLLOWING,
    Cause.STANDS_STILL,
    Cause.SWAPPED,
}
"""Causes that joints which arrive too seldom may have."""

CAUSES = tuple(Cause)
"""All causes, indexed by their codes."""

ACTIONS = tuple(int(cause.action) for cause in CAUSES)
"""Action of each cause, indexed by its code."""

INVALIDATED_EXPLORED = tuple(int(cause.declared.invalidates) for cause in CAUSES)
"""Value of `Invalidates` of each cause once an exploration is done, indexed by its code."""

INVALIDATED_UNEXPLORED = tuple(
    max(int(cause.declared.invalidates), int(cause.declared.invalidates_unexplored))
    for cause in CAUSES
)
"""Value of `Invalidates` of each cause before an exploration is done, indexed by its code."""

DETECTORS = tuple(
    (cause.bit, cause.declared.detector) for cause in CAUSES if cause.declared.detector is not None
)
"""Bit and detector of each cause that has a detector."""

declare_in("rcmservo.safety.compiled_detectors")


def find_causes(facts: TickFacts) -> int:
    """Return the set of causes that are detected at a tick, as the sum of their bits."""
    return sum(bit for bit, detects in DETECTORS if detects(facts))


@compiled
def find_invalidated(cause: int, explored: bool) -> int:
    """Return the state that a cause invalidates, as a value of `Invalidates`.

    Parameters
    ----------
    cause : int
        Code of the cause.
    explored : bool
        True if an exploration is done.
    """
    return INVALIDATED_EXPLORED[cause] if explored else INVALIDATED_UNEXPLORED[cause]


@compiled
def select_more_severe(first_cause: int, second_cause: int) -> int:
    """Return the code of the more severe one of two causes, given by their codes."""
    if first_cause == 0 or second_cause == 0:
        return max(first_cause, second_cause)
    return min(first_cause, second_cause)


@compiled
def select_most_severe(causes: int) -> int:
    """Return the code of the most severe cause of a set, given by its bits; 0 for the empty set."""
    if causes != 0:
        for code in range(1, len(ACTIONS)):
            if causes >> (code - 1) & 1:
                return code
    return 0
