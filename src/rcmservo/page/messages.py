"""What the page tells the servo: what a person wants, and that the person is still there."""

from dataclasses import dataclass
from typing import Annotated, Any

from rcmservo.constraints import FRACTION, Checked, Limit, Triple, at_most, each
from rcmservo.interfaces import Target
from rcmservo.page.pose_sequence import GoOnTour, HowFar
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo

LARGEST = at_most(1e9, "of its unit")
"""Limit of a rate that a browser asks for."""

ANSWER = 100
"""Characters of an answer."""

PRESS = Limit(lambda press: 0 <= press < 2**53, "a whole number from 0 to 2⁵³ − 1")
"""Limit of the number of a press: JavaScript holds it exactly."""


def one_line(most: int, noun: str = "one line") -> Limit:
    """Return the limit to a printable text of at most `most` characters."""
    words = f"{noun} of at most {most} characters"
    return Limit(lambda text: len(text) <= most and text.isprintable(), words)


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
class TeachAs:
    """Wanted: that the tool pauses, and that what the camera then sees becomes the target, and is
    kept by this name.

    Parameters
    ----------
    name : str
        Of the pose; empty where it is not kept.
    """

    name: str


@dataclass(frozen=True)
class Delete:
    """Wanted: that a pose is forgotten.

    Parameters
    ----------
    name : str
        Its name.
    """

    name: str


@dataclass(frozen=True)
class Held(Checked, section="jog"):
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

    rates: Annotated[Triple, each(LARGEST, "three numbers (rad/s, rad/s, mm/s) of at most 10⁹")]
    press: Annotated[int, PRESS]
    share: Annotated[float, FRACTION] = 1.0


@dataclass(frozen=True)
class Led(Checked, section="jog"):
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

    velocity: Annotated[Triple, each(LARGEST, "three numbers (mm/s) of at most 10⁹")]
    press: Annotated[int, PRESS]
    share: Annotated[float, FRACTION] = 1.0


@dataclass(frozen=True)
class Beat:
    """The person who has control is there, now, and holds nothing."""


@dataclass(frozen=True)
class Released:
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

    box: str
    value: Any


@dataclass(frozen=True)
class Wrong(Checked, section="trouble"):
    """Wanted: that something goes wrong with a simulated laboratory.

    Parameters
    ----------
    what : str
        As `--disturb` takes it, without `at`; empty: all that goes wrong ends.
    """

    what: Annotated[str, one_line(200, "a disturbance")]


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

    question: Annotated[str, one_line(400)]
    words: Annotated[str, one_line(ANSWER)]


Told = (
    Enable
    | Go
    | GoOnTour
    | TeachAs
    | Delete
    | Held
    | Led
    | Beat
    | Released
    | Change
    | Request
    | Wrong
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
class Between:
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
    ready: bool = False
    latched: bool = False
    clears: bool = False
    intent: str = ""
    asks: str = ""


@dataclass(frozen=True, eq=False)
class Aim:
    """What the loop goes to from now on.

    Parameters
    ----------
    target : Target
        What was shown.
    """

    target: Target


@dataclass(frozen=True, eq=False)
class Taught:
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
class InForce:
    """What the loop goes by from now on.

    Parameters
    ----------
    servo : Servo
        Its settings.
    """

    servo: Servo


@dataclass(frozen=True)
class OnTour:
    """How far a tour is.

    Parameters
    ----------
    progress : HowFar or None
        None where there is none, or none any more.
    """

    progress: HowFar | None


@dataclass(frozen=True)
class Teaching:
    """How far teaching is.

    Parameters
    ----------
    words : str
        In words; empty where nothing is being taught.
    """

    words: str


Said = Note | Between | Aim | Taught | InForce | OnTour | Teaching
"""What servo process and supervisor tell the page beside the ticks."""

STOP, CLEAR = "stop", "clear"
"""What the supervisor is told: that a person has pressed STOP; that the stop is over."""
