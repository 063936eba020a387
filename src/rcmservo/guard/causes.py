"""Why the tool is not simply on its way: every cause in words, with its action and its way out."""

from enum import Enum, IntEnum

from rcmservo.compiled import compiled


class Action(IntEnum):
    """What a cause asks for; the greatest wins."""

    NONE = 0
    WARN = 1
    SLOW = 2
    HOLD = 3
    PAUSE = 4
    FAULT = 5


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
    CLOCK_STOOD = (
        "the loop's clock stood still or went back",
        Action.FAULT,
        "mend the clock, then clear and enable again",
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
        "look for a blocked, slipping or wrongly wired axis, or set thresholds.drive_lag for slow "
        "drives, then clear and enable again",
    )
    CREEPS = (
        "the joints move while nothing is commanded",
        Action.FAULT,
        "find what moves them, such as a slipping brake, an offset of the drive or a hand, then "
        "clear and enable again",
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
    FROZEN = (
        "the picture stands still while the tool moves",
        Action.PAUSE,
        "let the camera's picture run again, then resume",
    )
    DRIFTS = (
        "the markers drift away from where the joints put them: the camera moves, turns or zooms, "
        "or something slides along with them",
        Action.PAUSE,
        "see that the camera stands still, show the target again, then resume: the servo explores "
        "anew",
    )
    ELSEWHERE = (
        "the picture shows the tool at the target, but the joints say that it is elsewhere: a "
        "pose beyond a singular surface looks the same, or since the target was shown the camera "
        "was moved or zoomed, or the arm's zero has changed",
        Action.PAUSE,
        "show the target again, then resume",
    )
    DIVERGED = (
        "the markers keep moving otherwise than the estimate says",
        Action.PAUSE,
        "check that the tool is rigid and the arm tells its joints rightly, then resume: the "
        "servo explores anew",
    )
    OVERRUN = (
        "the loop ran late: several ticks in a row, or one by more than its bound",
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
        "the target lies at or beyond a singular surface: no motion that the estimate knows of "
        "brings the features nearer to it",
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
    WITHOUT_MARKER_1 = (
        "marker 1 is not seen: marker 2 and the joints tell the pose",
        Action.SLOW,
        "",
    )
    WITHOUT_MARKER_2 = (
        "marker 2 is not seen: marker 1 and the joints tell the pose",
        Action.SLOW,
        "",
    )
    AGEING = "no new frame has come for longer than usual", Action.SLOW, ""
    NEARLY_SINGULAR = (
        "a singular surface nearly closes the way to the target",
        Action.SLOW,
        "",
    )

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
    def stopping(self) -> str:
        """Its sentence if the tool stands still for it; empty if it goes on."""
        return self.value if self.action >= Action.HOLD else ""

    @property
    def bit(self) -> int:
        """Its bit in a set of causes that is kept as one number; 0 for NONE."""
        return BITS[self]

    @property
    def place(self) -> int:
        """Its place among the causes, which stands for it in compiled functions; 0 for NONE."""
        return PLACES[self]


CAUSES = tuple(Cause)
PLACES = {cause: place for place, cause in enumerate(CAUSES)}
BITS = {cause: (1 << place) >> 1 for cause, place in PLACES.items()}

ACTIONS = tuple(int(cause.action) for cause in CAUSES)
"""What each asks for, by its place."""


@compiled
def graver(one: int, other: int) -> int:
    """Of two causes, by their places, the one with the greater action, the one listed first of
    equal ones."""
    if ACTIONS[one] == ACTIONS[other]:
        return min(one, other)
    return one if ACTIONS[one] > ACTIONS[other] else other


@compiled
def gravest(found: int) -> int:
    """The place of the gravest cause in a set of them; 0 where there is none."""
    cause = 0
    if found == 0:
        return cause
    for place in range(1, len(ACTIONS)):
        if found >> (place - 1) & 1 and ACTIONS[place] > ACTIONS[cause]:
            cause = place
    return cause
