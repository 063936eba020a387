"""What the page tells the servo: what a person wants, and that the person is still there."""

from dataclasses import dataclass
from typing import Annotated, Any

from rcmservo.constraints import FRACTION, Checked, Limit, Triple, at_most, each
from rcmservo.interfaces import Target
from rcmservo.page.pose_sequence import RunSequence, SequenceProgress
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo

RATE_LIMIT = at_most(1e9, "of its unit")
"""Limit of a rate that a browser asks for."""

MAX_ANSWER_CHARACTERS = 100
"""Characters of an answer."""

PRESS_NUMBER_LIMIT = Limit(lambda press: 0 <= press < 2**53, "a whole number from 0 to 2⁵³ − 1")
"""Limit of the number of a press: JavaScript holds it exactly."""


def single_line_text(max_characters: int, noun: str = "one line") -> Limit:
    """Return the limit to a printable text of at most `most` characters."""
    words = f"{noun} of at most {max_characters} characters"
    return Limit(lambda text: len(text) <= max_characters and text.isprintable(), words)


@dataclass(frozen=True)
class Enable:
    """Wanted: that the drive goes on, with the tool's present pose as the first target."""


@dataclass(frozen=True, eq=False)
class Go:
    """Wanted: that the tool goes to a target.

    Parameters
    ----------
    target : Target
        Where to.
    """

    target: Target


@dataclass(frozen=True)
class TeachPose:
    """Wanted: that the tool pauses, and that what the camera then sees becomes the target, and is
    kept by this name.

    Parameters
    ----------
    name : str
        Of the pose; empty where it is not kept.
    """

    name: str


@dataclass(frozen=True)
class DeletePose:
    """Wanted: that a pose is forgotten.

    Parameters
    ----------
    name : str
        Its name.
    """

    name: str


@dataclass(frozen=True)
class JogJoints(Checked, section="jog"):
    """A person holds a jog button down, now.

    Parameters
    ----------
    rates : Triple
        Joint rates rad/s, rad/s, mm/s.
    press : int
        Which press it is: what ended one press is not gone on with before the next.
    share : float
        Of the speed that a jog may have.
    """

    rates: Annotated[Triple, each(RATE_LIMIT, "three numbers (rad/s, rad/s, mm/s) of at most 10⁹")]
    press: Annotated[int, PRESS_NUMBER_LIMIT]
    speed_scale: Annotated[float, FRACTION] = 1.0


@dataclass(frozen=True)
class JogMarker(Checked, section="jog"):
    """A person holds a button down, now, that leads marker 1 in a direction of the arm's base
    frame.

    Parameters
    ----------
    velocity : Triple
        Of marker 1 along x, y, z, mm/s.
    press : int
        Which press it is, as for Held.
    share : float
        Of the speed that a jog may have.
    """

    velocity: Annotated[Triple, each(RATE_LIMIT, "three numbers (mm/s) of at most 10⁹")]
    press: Annotated[int, PRESS_NUMBER_LIMIT]
    speed_scale: Annotated[float, FRACTION] = 1.0


@dataclass(frozen=True)
class Heartbeat:
    """The person who has control is there, now, and holds nothing."""


@dataclass(frozen=True)
class ReleaseJog:
    """The person has let go of the button."""


@dataclass(frozen=True, eq=False)
class Change:
    """Wanted: that a box of the servo has other settings.

    Parameters
    ----------
    box : str
        Which one.
    value : Any
        Its settings.
    """

    part: str
    value: Any


@dataclass(frozen=True)
class DisturbanceRequest(Checked, section="trouble"):
    """Wanted: that something goes wrong with a simulated laboratory.

    Parameters
    ----------
    what : str
        As `--disturb` takes it, without `at`; empty: all that goes wrong ends.
    """

    what: Annotated[str, single_line_text(200, "a disturbance")]


@dataclass(frozen=True)
class Reply(Checked, section="answer"):
    """What a person answers to a question.

    Parameters
    ----------
    question : str
        Which one, in its words: an answer to another one counts for nothing.
    words : str
        The answer.
    """

    question: Annotated[str, single_line_text(400)]
    words: Annotated[str, single_line_text(MAX_ANSWER_CHARACTERS)]


BrowserMessage = (
    Enable
    | Go
    | RunSequence
    | TeachPose
    | DeletePose
    | JogJoints
    | JogMarker
    | Heartbeat
    | ReleaseJog
    | Change
    | Request
    | DisturbanceRequest
    | Reply
)
"""What comes from a browser."""


@dataclass(frozen=True)
class Note:
    """A sentence for the person.

    Parameters
    ----------
    words : str
        The sentence.
    """

    words: str


@dataclass(frozen=True)
class Standby:
    """There is no loop: before the drive is on, or after a stop.

    Parameters
    ----------
    words : str
        What there is instead.
    ready : bool
        Whether the drive can be switched on.
    latched : bool
        Whether it stays so until the person clears it,
    clears : bool
        and whether that can be done now.
    intent : str
        What is going to happen once the drive is on.
    asks : str
        What the person is asked; empty where that is nothing.
    """

    words: str
    can_enable: bool = False
    latched: bool = False
    can_clear: bool = False
    intent: str = ""
    question: str = ""


@dataclass(frozen=True, eq=False)
class TargetChanged:
    """What the loop goes to from now on.

    Parameters
    ----------
    target : Target
        What was shown.
    """

    target: Target


@dataclass(frozen=True, eq=False)
class PoseTaught:
    """A target was taught.

    Parameters
    ----------
    name : str
        What it is called.
    target : Target
        What the camera saw.
    """

    name: str
    target: Target


@dataclass(frozen=True, eq=False)
class SettingsApplied:
    """What the loop goes by from now on.

    Parameters
    ----------
    servo : Servo
        Its settings.
    """

    servo: Servo


@dataclass(frozen=True)
class SequenceStatus:
    """How far a tour is.

    Parameters
    ----------
    progress : HowFar or None
        None where there is none, or none any more.
    """

    progress: SequenceProgress | None


@dataclass(frozen=True)
class TeachingStatus:
    """How far teaching is.

    Parameters
    ----------
    words : str
        In words; empty where nothing is being taught.
    """

    words: str


StatusMessage = (
    Note | Standby | TargetChanged | PoseTaught | SettingsApplied | SequenceStatus | TeachingStatus
)
"""What servo process and supervisor tell the page beside the ticks."""

STOP, CLEAR = "stop", "clear"
"""What the supervisor is told: that a person has pressed STOP; that the stop is over."""
