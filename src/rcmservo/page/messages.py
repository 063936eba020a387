"""Messages between browser, servo process and supervisor.

`BrowserMessage` lists the requests of a browser, `StatusMessage` the reports to the page.
"""

from dataclasses import dataclass
from typing import Annotated, Any

from rcmservo.constraints import FRACTION, Checked, Limit, Triple, between, each
from rcmservo.interfaces import Target
from rcmservo.page.pose_sequence import RunSequence, SequenceProgress
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo

RATE_LIMIT = between(-1e9, 1e9)
"""Limit of a rate that a browser requests."""

MAX_ANSWER_CHARACTERS = 100
"""Longest answer to a question, in characters."""

PRESS_NUMBER_LIMIT = Limit(lambda press: 0 <= press < 2**53, "a whole number from 0 to 2⁵³ − 1")
"""Limit of the number of a press, the largest range that JavaScript represents exactly."""


def single_line_text(max_characters: int, noun: str = "one line") -> Limit:
    """Return the limit to a printable text of at most `max_characters`."""
    expected = f"{noun} of at most {max_characters} characters"
    return Limit(lambda text: len(text) <= max_characters and text.isprintable(), expected)


@dataclass(frozen=True)
class Enable:
    """Request to switch the drive on, with the tool's present pose as the first target."""


@dataclass(frozen=True, eq=False)
class Go:
    """Request to move the tool to a target.

    Parameters
    ----------
    target : Target
        Target to reach.
    """

    target: Target


@dataclass(frozen=True)
class TeachPose:
    """Request to pause the tool and to teach the present observation as the target.

    Parameters
    ----------
    name : str
        Name under which the pose is stored; empty if it is not stored.
    """

    name: str


@dataclass(frozen=True)
class DeletePose:
    """Request to delete a stored pose.

    Parameters
    ----------
    name : str
        Name of the pose.
    """

    name: str


@dataclass(frozen=True)
class JogJoints(Checked, section="jog"):
    """Report that a button that jogs joints is held down now.

    Parameters
    ----------
    rates : Triple
        Joint rates (3,) rad/s, rad/s, mm/s.
    press : int
        Number of the press. Each press has a number of its own, and one that was ended stays ended.
    speed_scale : float
        Fraction of the jog speed, above 0 and at most 1.
    """

    rates: Annotated[Triple, each(RATE_LIMIT, "three numbers (rad/s, rad/s, mm/s) of at most 10⁹")]
    press: Annotated[int, PRESS_NUMBER_LIMIT]
    speed_scale: Annotated[float, FRACTION] = 1.0


@dataclass(frozen=True)
class JogMarker(Checked, section="jog"):
    """Report that a button that moves marker 1 is held down now.

    Parameters
    ----------
    velocity : Triple
        Velocity (3,) of marker 1 along x, y, z of the arm's base frame, mm/s.
    press : int
        Number of the press, as for `JogJoints`.
    speed_scale : float
        Fraction of the jog speed, above 0 and at most 1.
    """

    velocity: Annotated[Triple, each(RATE_LIMIT, "three numbers (mm/s) of at most 10⁹")]
    press: Annotated[int, PRESS_NUMBER_LIMIT]
    speed_scale: Annotated[float, FRACTION] = 1.0


@dataclass(frozen=True)
class Heartbeat:
    """Sign of life from the browser in control while no jog button is held down."""


@dataclass(frozen=True)
class ReleaseJog:
    """Report that the jog button was released."""


@dataclass(frozen=True, eq=False)
class SettingsChange:
    """Request to change the settings of one part of the servo.

    Parameters
    ----------
    part : str
        Name of the part, such as "controller".
    value : Any
        New settings of the part.
    """

    part: str
    value: Any


@dataclass(frozen=True)
class DisturbanceRequest(Checked, section="disturbance"):
    """Request to disturb a simulated laboratory.

    Parameters
    ----------
    disturbance : str
        Disturbance as `--disturb` takes it, without `at`; empty to end all disturbances.
    """

    disturbance: Annotated[str, single_line_text(200, "a disturbance")]


@dataclass(frozen=True)
class Reply(Checked, section="answer"):
    """Answer to a question.

    Parameters
    ----------
    question : str
        Text of the question. An answer to another question is ignored.
    words : str
        Answer.
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
    | SettingsChange
    | Request
    | DisturbanceRequest
    | Reply
)
"""Messages from a browser."""


@dataclass(frozen=True)
class Note:
    """Sentence to display to the operator.

    Parameters
    ----------
    words : str
        Sentence.
    """

    words: str


@dataclass(frozen=True)
class Standby:
    """State of the session while no loop runs: before the drive is on, or after a stop.

    Parameters
    ----------
    words : str
        State in words.
    can_enable : bool
        The drive can be switched on.
    is_latched : bool
        The state remains until the operator clears it.
    can_clear : bool
        The operator can clear it now.
    intent : str
        Description of what happens once the drive is on.
    question : str
        Question to the operator; empty if there is none.
    """

    words: str
    can_enable: bool = False
    is_latched: bool = False
    can_clear: bool = False
    intent: str = ""
    question: str = ""


@dataclass(frozen=True, eq=False)
class TargetChanged:
    """Report of a new target of the loop.

    Parameters
    ----------
    target : Target
        New target.
    """

    target: Target


@dataclass(frozen=True, eq=False)
class PoseTaught:
    """Report of a taught pose.

    Parameters
    ----------
    name : str
        Name of the pose.
    target : Target
        Observed markers and joints.
    """

    name: str
    target: Target


@dataclass(frozen=True, eq=False)
class SettingsApplied:
    """Report of the settings that the loop uses from now on.

    Parameters
    ----------
    servo : Servo
        Servo with these settings.
    """

    servo: Servo


@dataclass(frozen=True)
class SequenceStatus:
    """Report of the progress of a pose sequence.

    Parameters
    ----------
    progress : SequenceProgress or None
        Progress; None if no sequence runs.
    """

    progress: SequenceProgress | None


@dataclass(frozen=True)
class TeachingStatus:
    """Report of the progress of teaching.

    Parameters
    ----------
    words : str
        Progress in words; empty if no pose is being taught.
    """

    words: str


StatusMessage = (
    Note | Standby | TargetChanged | PoseTaught | SettingsApplied | SequenceStatus | TeachingStatus
)
"""Messages from the servo process and the supervisor to the page, in addition to the ticks."""

STOP, CLEAR = "stop", "clear"
"""Messages to the supervisor: STOP was pressed; the stop was cleared."""
