"""Causes of a stop: each is one object with its sentence, action, way out, detector and what it
invalidates. Compiled functions have the same table as numbers, by the causes' places in it.
"""

from collections.abc import Callable
from enum import Enum, IntEnum
from functools import partial
from typing import Any, NamedTuple

from rcmservo.numerics.jit import compiled, declare_in
from rcmservo.safety.checks import devices, drift, estimate, exploration, markers, progress
from rcmservo.safety.checks.facts import DetailFacts, TickFacts

TEACH_AGAIN = "show the target again"
"""Words of a way out that includes teaching the target in the present view."""


class Action(IntEnum):
    """Action that a cause requests; the greatest one wins."""

    NONE = 0
    WARN = 1
    SLOW = 2
    HOLD = 3
    PAUSE = 4
    FAULT = 5


class Invalidates(IntEnum):
    """Knowledge that a pause or fault invalidates.

    The rest is kept, and with it the newest frame accepted, so that a camera moved meanwhile is
    noticed.
    """

    NOTHING = 0
    ESTIMATE = 1
    ESTIMATE_AND_TARGETS = 2
    """As after a moved camera."""


class Declaration(NamedTuple):
    """Declaration of a cause.

    Parameters
    ----------
    action : Action
        Action that it requests.
    sentence : str
        Description for the operator.
    way_out : str
        Remedy for the operator.
    detector : Callable[[TickFacts], bool] or None
        Compiled function that detects it at a tick; None where gate or state machine raise it.
    invalidates : Invalidates
        Knowledge that it invalidates.
    invalidates_unexplored : Invalidates
        Knowledge that it invalidates before an exploration is done, if that is more.
    hides_markers : bool
        True if it explains why no marker is detected.
    detail : Callable[[DetailFacts], str]
        Function that words which joint it is, its value and its limit.
    """

    action: Action
    sentence: str
    way_out: str = ""
    detector: Callable[[TickFacts], bool] | None = None
    invalidates: Invalidates = Invalidates.NOTHING
    invalidates_unexplored: Invalidates = Invalidates.NOTHING
    hides_markers: bool = False
    detail: Callable[[DetailFacts], str] = lambda facts: ""


warn, slow, hold, pause, fault = (partial(Declaration, action) for action in list(Action)[1:])


class Cause(Enum):
    """Cause of a stop, of slow motion or of a warning. Its value is the sentence for the operator.

    Graver actions stand first, and of several causes present the first is named.
    """

    declared: Declaration
    action: Action
    way_out: str
    place: int
    """Its position, which stands for it in compiled functions; 0 for NONE."""
    bit: int
    """Its bit in a set of causes that is kept as one number; 0 for NONE."""

    def __new__(cls, *declared: Any) -> "Cause":
        cause = object.__new__(cls)
        cause.declared = Declaration(*declared)
        cause.action, cause._value_, cause.way_out, *_ = cause.declared
        cause.place = len(cls.__members__)
        cause.bit = (1 << cause.place) >> 1
        return cause

    NONE = Declaration(Action.NONE, "")
    NOT_FINITE = fault(
        "a number that is not finite reached the last gate",
        "this is an error in the software: keep the record, clear, and enable again",
        invalidates=Invalidates.ESTIMATE,
    )
    ESTIMATOR_FAILED = fault(
        "the estimator raised an error, or gave what is no Jacobian",
        "mend the estimator and begin a new run",
        estimate.estimator_failed,
        invalidates=Invalidates.ESTIMATE,
    )
    ESTIMATE_NOT_FINITE = fault(
        "the estimator gave a number that is not finite",
        "this is an error in the estimator: keep the record, clear, and enable again",
        estimate.estimate_is_not_finite,
        invalidates=Invalidates.ESTIMATE,
    )
    JOINTS_NOT_FINITE = fault(
        "the arm tells joints that are not finite",
        "check the encoders, then clear and enable again",
        devices.joints_are_not_finite,
        detail=devices.describe_not_finite,
    )
    CLOCK_STOOD = fault(
        "the loop's clock stood still or went back",
        "mend the clock, then clear and enable again",
        devices.clock_stood,
    )
    DRIVE_OFF = fault(
        "the arm's drive went off: its watchdog or an emergency stop has switched it off",
        "find out what stopped it, then clear and enable again",
        devices.drive_went_off,
    )
    ARM_SILENT = fault(
        "the arm has not answered for too long",
        "check the arm's connection, then clear and enable again",
        devices.arm_is_silent,
    )
    NOT_FOLLOWING = fault(
        "the joints do not follow the commands",
        "look for a blocked, slipping or wrongly wired axis, or set thresholds.drive_lag for slow "
        "drives, then clear and enable again",
        devices.joints_do_not_follow,
        detail=devices.describe_following,
    )
    CREEPS = fault(
        "the joints move while nothing is commanded",
        "find what moves them, such as a slipping brake, an offset of the drive or a hand, then "
        "clear and enable again",
        devices.joints_creep,
        detail=devices.describe_creeping,
    )
    BEYOND_LIMIT = fault(
        "a joint is beyond its limit",
        "bring the tool back by hand, then clear and enable again",
        devices.joint_is_beyond_limit,
        detail=devices.describe_limits,
    )
    CAMERA_MOVED = pause(
        "the markers jumped while the joints did not: the camera was moved",
        "show the target again in the new view, then resume: the servo explores anew",
        markers.camera_moved,
        invalidates=Invalidates.ESTIMATE_AND_TARGETS,
    )
    SWAPPED = pause(
        "the markers are taken for each other",
        "see that nothing else looks like a marker, and that marker 1 is the one nearer the RCM, "
        "then resume",
        markers.markers_are_swapped,
        invalidates_unexplored=Invalidates.ESTIMATE,
    )
    SURPRISED = pause(
        "the markers are not where the tool's motion puts them: something else is taken for one, "
        "or the camera moved",
        "see that nothing else looks like a marker, then resume",
        markers.markers_are_unexpected,
        invalidates_unexplored=Invalidates.ESTIMATE_AND_TARGETS,
    )
    FROZEN = pause(
        "the picture stands still while the tool moves",
        "let the camera's picture run again, then resume",
        drift.picture_is_frozen,
    )
    DRIFTS = pause(
        "the markers drift away from where the joints put them: the camera moves, turns or zooms, "
        "or something slides along with them",
        "see that the camera stands still, show the target again, then resume: the servo explores "
        "anew",
        drift.markers_drift,
        invalidates=Invalidates.ESTIMATE_AND_TARGETS,
    )
    ELSEWHERE = pause(
        "the picture shows the tool at the target, but the joints say that it is elsewhere: a "
        "pose beyond a singular surface looks the same, or since the target was shown the camera "
        "was moved or zoomed, or the arm's zero has changed",
        "show the target again, then resume",
        progress.tool_is_elsewhere,
    )
    DIVERGED = pause(
        "the markers keep moving otherwise than the estimate says",
        "check that the tool is rigid and the arm tells its joints rightly, then resume: the "
        "servo explores anew",
        estimate.estimate_diverged,
        invalidates=Invalidates.ESTIMATE,
    )
    OVERRUN = pause(
        "the loop ran late: several ticks in a row, or one by more than its bound",
        "take other work off this computer, then resume",
        devices.loop_overran,
    )
    NOT_RECORDED = pause(
        "the record can no longer be written",
        "make room on the disk and start a new run",
        devices.recording_failed,
    )
    NO_ROOM = pause(
        "the joint limits leave no room to explore around the start",
        "bring the tool further from its limits, then resume",
        exploration.there_is_no_room,
    )
    NOT_EXPLORED = pause(
        "exploration ended without an estimate that predicts what the camera sees",
        "check mechanism and tool in the rig file, or allow a larger exploration, then resume",
        exploration.exploration_failed,
        invalidates=Invalidates.ESTIMATE,
        detail=exploration.advise,
    )
    STALLED = pause(
        "the feature error has stopped falling: the target cannot be reached from here",
        "bring the tool to another start, or show a target within reach, then resume",
        progress.progress_stalled,
    )
    TARGET_OLD = pause(
        "the target was shown before the camera was moved",
        "show the target again, then resume",
        progress.target_is_old,
    )
    ASKED = pause("a person asked for a pause", "resume when ready")
    MARKERS_LOST = hold(
        "neither marker is seen: they left the picture or are hidden",
        "clear the view, then resume",
        markers.both_markers_are_lost,
        hides_markers=True,
    )
    MARKER_1_LOST = hold(
        "marker 1 is not seen: it left the picture or is hidden",
        "clear the view, then resume",
        markers.marker_1_is_lost,
        hides_markers=True,
    )
    MARKER_2_LOST = hold(
        "marker 2 is not seen: it left the picture or is hidden",
        "clear the view, then resume",
        markers.marker_2_is_lost,
        hides_markers=True,
    )
    FRAMES_DAMAGED = hold(
        "frames come damaged",
        "check the camera and its cable, then resume",
        devices.frames_are_damaged,
        hides_markers=True,
    )
    FRAMES_NOT_NEW = hold(
        "frames come repeated or out of order",
        "check the camera's driver, then resume",
        devices.frames_are_not_new,
        hides_markers=True,
    )
    FRAMES_CLOCK = hold(
        "frames bear times that cannot be right",
        "check the camera's clock, then resume",
        devices.frame_times_are_invalid,
        hides_markers=True,
    )
    STALE = hold(
        "no new frame has come from the camera for too long",
        "check the camera, then resume",
        devices.frames_stopped,
        hides_markers=True,
    )
    LATE = hold(
        "the frames come too long after their exposure",
        "make camera and tracking faster, then resume",
        devices.frames_come_late,
    )
    JOINTS_UNKNOWN = hold(
        "the joints' positions at the exposure of the frame are not known",
        "check that camera and arm keep the same time, then resume",
        devices.joints_at_exposure_are_unknown,
    )
    RCM_UNKNOWN = hold(
        "the imaged RCM cannot be computed: the lines seen of the tool are too much alike",
        "turn the camera so that the tool is not seen from its end, then resume",
        estimate.rcm_is_unknown,
    )
    ESTIMATE_LARGE = hold(
        "the estimate is out of bounds: no camera sees a tool move so fast",
        "resume: the servo explores anew",
        estimate.estimate_is_large,
        invalidates=Invalidates.ESTIMATE,
    )
    SINGULAR = hold(
        "the target lies at or beyond a singular surface: no motion that the estimate knows of "
        "brings the features nearer to it",
        "bring the tool nearer to the target or away from the singular pose, then resume",
        progress.path_is_singular,
    )
    JOINT_1_LIMIT = hold(
        "the way to the target goes past the limit of joint 1",
        "bring the tool to another start, then resume",
        progress.joint_1_blocks_the_path,
    )
    JOINT_2_LIMIT = hold(
        "the way to the target goes past the limit of joint 2",
        "bring the tool to another start, then resume",
        progress.joint_2_blocks_the_path,
    )
    JOINT_3_LIMIT = hold(
        "the way to the target goes past the limit of joint 3",
        "bring the tool to another start, then resume",
        progress.joint_3_blocks_the_path,
    )
    REJECTED = slow(
        "a frame was not believed: the markers are not where the tool's motion puts them",
        detector=markers.frame_was_rejected,
    )
    WITHOUT_MARKER_1 = slow(
        "marker 1 is not seen: marker 2 and the joints tell the pose",
        detector=markers.marker_1_is_completed,
    )
    WITHOUT_MARKER_2 = slow(
        "marker 2 is not seen: marker 1 and the joints tell the pose",
        detector=markers.marker_2_is_completed,
    )
    AGEING = slow("no new frame has come for longer than usual", detector=devices.frame_is_old)
    NEARLY_SINGULAR = slow(
        "a singular surface nearly closes the way to the target",
        detector=progress.path_is_nearly_singular,
    )
    LATE_TICK = warn("the loop ran late by a tick", detector=devices.tick_came_late)

    @property
    def needs_teaching(self) -> bool:
        """True if the way out includes teaching the target again."""
        return TEACH_AGAIN in self.way_out

    @property
    def words(self) -> str:
        """The sentence and the way out, as one text."""
        return self.describe("")

    def describe(self, detail: str) -> str:
        """Return sentence, detail and way out as one text."""
        sentence = f"{self.value}: {detail}" if detail else self.value
        return f"{sentence} ({self.way_out})" if self.way_out else sentence

    @property
    def stopping(self) -> str:
        """Its sentence if it stops the tool; empty otherwise."""
        return self.value if self.action >= Action.HOLD else ""


CAUSES = tuple(Cause)
ACTIONS = tuple(int(cause.action) for cause in CAUSES)
"""Action of each, by its place."""

EXPLORED = tuple(int(cause.declared.invalidates) for cause in CAUSES)
"""Knowledge that each invalidates, by its place."""

UNEXPLORED = tuple(
    max(int(cause.declared.invalidates), int(cause.declared.invalidates_unexplored))
    for cause in CAUSES
)
"""The same before an exploration is done."""

DETECTORS = tuple(
    (cause.bit, cause.declared.detector) for cause in CAUSES if cause.declared.detector is not None
)
"""Bit and detector of each cause that has one."""

declare_in("rcmservo.safety.compiled_detectors")


def find_causes(facts: TickFacts) -> int:
    """Return the set of the causes that their detectors find at a tick."""
    found = 0
    for bit, detects in DETECTORS:
        if detects(facts):
            found |= bit
    return found


@compiled
def invalidated_by(cause: int, explored: bool) -> int:
    """Return the knowledge that a cause, by its place, invalidates."""
    return EXPLORED[cause] if explored else UNEXPLORED[cause]


@compiled
def graver(one: int, other: int) -> int:
    """Return the graver one of two causes, by their places."""
    return max(one, other) if one == 0 or other == 0 else min(one, other)


@compiled
def gravest(found: int) -> int:
    """Return the place of the gravest cause in a set of them; 0 where there is none."""
    if found != 0:
        for place in range(1, len(ACTIONS)):
            if found >> (place - 1) & 1:
                return place
    return 0
