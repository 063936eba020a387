"""What the servo sees of the world and does to it: frames, observations, commands, targets, and the
devices' Protocols.

Time is integer nanoseconds on the plant's clock. A pixel (0, 0) is the centre of the top left
pixel, u right, v down.
"""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Annotated, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rcmservo.rows import struct_reader, tuple_struct

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Three = Annotated[Floats, (3,)]
"""Three numbers, one for each joint."""
Pixels = Annotated[Floats, (2, 2)]
"""Pixels (u, v) of both markers."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of a camera. A camera that makes pictures fills `image`; one that simulates only
    the markers fills `points`."""

    number: int
    """It rises from frame to frame."""
    exposure: int
    """The middle of the exposure, ns."""
    arrival: int
    """When the computer had the frame, ns."""
    image: Image | None = None
    """(height, width, 3) uint8, blue-green-red as in OpenCV. None where there is none, or where it
    came damaged."""
    points: Floats | None = None
    """(2, 2) px: m1 and m2, NaN where unseen. None where the camera makes pictures."""


@dataclass(frozen=True, eq=False)
class Markers:
    """Where a tracker saw the two markers."""

    points: Floats
    """(2, 2) px: row 0 is m1 (nearer the RCM), row 1 is m2 (nearer the tip). NaN where lost, never
    a guess."""
    radius: Floats
    """(2,) px of the imaged markers; NaN where it is not known."""
    quality: Floats
    """(2,) from 0 (lost) to 1."""
    covariance: Floats = field(default_factory=lambda: np.full((2, 3, 3), np.nan))
    """(2, 3, 3) px², of the noise in u, v and radius of each marker; NaN where it is lost or not
    known. What is wrong alike in every frame is not in it."""


class Dropped(IntEnum):
    """Why the newest frame that a camera offered was not used. ``words`` is that for the
    operator."""

    _value_: int
    words: str

    def __new__(cls, words: str) -> Self:
        code = len(cls.__members__)
        member = int.__new__(cls, code)
        member._value_, member.words = code, words
        return member

    NONE = ""
    NOT_NEW = "frames come repeated or out of order"
    CLOCK = "frames bear times that cannot be right"
    DAMAGED = "frames come damaged"


@dataclass(frozen=True, eq=False)
class Observation:
    """All that a servo is told at one tick. Times are ns on the plant's clock."""

    now: int
    """The moment of the observation."""
    q: Three
    """The joints (3,) rad, rad, mm, as the arm last told them."""
    q_time: int
    """When the arm read them."""
    enabled: bool
    """Whether the arm's drive is on."""
    applied: Three
    """The joint rates (3,) rad/s, rad/s, mm/s that the arm took of the last command; zeros before
    the first."""
    frame: int
    """Number of the newest frame used, -1 before the first."""
    exposure: int
    """The middle of that frame's exposure; 0 before the first."""
    arrival: int
    """When the computer had that frame; 0 before the first."""
    q_exposure: Three
    """The joints (3,) at the exposure; NaN where they are not known."""
    points: Pixels
    """The markers (2, 2) raw px in that frame, NaN where lost."""
    dropped: Dropped = Dropped.NONE
    """Why the frame offered last was not used; NONE where nothing is wrong with it."""
    recorded: bool = True
    """False once a record that was asked for is no longer written."""
    sizes: Floats = field(default_factory=lambda: np.full(2, np.nan))
    """The markers' apparent radii (2,) px, NaN where lost or not known."""
    quality: Floats = field(default_factory=lambda: np.full(2, np.nan))
    """How well the tracker saw the markers (2,), from 0 (lost) to 1; NaN where not known. It is for
    people: no motion is decided by it."""


if TYPE_CHECKING:
    ObservationStruct = Observation
else:
    ObservationStruct = tuple_struct(Observation, without=("sizes", "quality"))

observed_numbers = struct_reader(Observation, ObservationStruct)
"""Function that reads the numbers of an `ObservationStruct` off an `Observation`."""


@dataclass(frozen=True, eq=False)
class Command:
    """What an arm is to do. Only the gate makes one."""

    number: int
    """It rises from command to command."""
    time: int
    """That of its tick, ns."""
    deadline: int
    """ns. After it the command is void, and an arm that has no newer one stops and switches its
    drive off."""
    rates: Three
    """The joint rates (3,) rad/s, rad/s, mm/s."""
    enabled: bool
    """False switches the arm's drive off at once."""


@dataclass(frozen=True, eq=False)
class Target:
    """What was shown. y_d is computed from it about the imaged RCM as known later."""

    points: Floats
    """The markers (2, 2) raw px."""
    q: Floats
    """The joints (3,) rad, rad, mm while it was shown; NaN where nobody knows. No motion is decided
    by them; they tell whether a pose that looks the same is the same, and stop the tool where it is
    not."""
    shown: int = 0
    """When showing it began, ns on the plant's clock (0: earlier than all that is known). A target
    from before the camera was moved is refused."""
    sizes: Floats = field(default_factory=lambda: np.full(2, np.nan))
    """The markers' apparent radii (2,) px while it was shown; NaN where not known."""


class Clock(Protocol):
    """The plant's time, in whole ns. It never goes back, and all times in this file are on it.

    In simulation it passes only while somebody waits. On hardware it is `WallClock`, the computer's
    own time since it was started.
    """

    def now(self) -> int:
        """The present, at once."""
        ...

    def wait_until(self, time: int) -> None:
        """Wait until a moment; not at all if it is past. Called once a tick."""
        ...


class Measured(NamedTuple):
    """An arm's last answer."""

    time: int
    """When the joints were read, ns on the plant's clock."""
    q: Floats
    """The joints (3,) rad, rad, mm."""
    enabled: bool
    """Whether the drive is on."""


class Arm(Protocol):
    """An arm with velocity drives and a watchdog of its own.

    The loop calls `measure` and `apply` once in every tick (at `Servo.rate`, 100 Hz), and both must
    return at once, within a millisecond. An arm that does not answer is no error: give what it told
    last. Its time then grows old, and the servo stops with the fault "the arm has not answered for
    too long". An exception ends the run: the arm is told to stop, and the exception goes to the
    caller.
    """

    def enable(self) -> None:
        """Switch the drive on, at rest: a person's act, before the first tick of a run.

        It may block until the drive is on. `measure` must tell so within 2 s after it returns. If
        the drive cannot be switched on, raise an error that says why.
        """
        ...

    def measure(self) -> Measured:
        """The arm's last answer, at once, and the same one until the next has come.

        Its time is the moment at which the joints were read, on the plant's clock. It is also asked
        while nothing moves: while a target is taught, with the drive off.
        """
        ...

    def apply(self, command: Command) -> Floats:
        """Pass a command on, at once; the joint rates (3,) rad/s, rad/s, mm/s that the arm takes.

        Give what is known: rates that the arm has cut, or zeros where it took nothing. A command
        that is not ``enabled`` switches the drive off. A command counts until its deadline; the arm
        itself must stop and switch off where no newer one has come by then, also when this program
        has died.
        """
        ...


class Camera(Protocol):
    """A camera at its own pace."""

    def latest(self) -> Frame | None:
        """The newest frame that has arrived, at once: the same object until the next; None before
        the first.

        It is called in every tick (100 Hz), or by a `TrackingThread` every millisecond. A camera
        that does not answer is no error: give the last frame again. It then grows old, and the
        servo slows down, holds and pauses. Frame numbers rise. Exposure and arrival are on the
        plant's clock: where the camera has a clock of its own, its driver converts.
        """
        ...


class Tracker(Protocol):
    """Frames to marker centres. It may remember where the markers were."""

    def find(self, frame: Frame) -> Markers:
        """Where the markers are in a frame; NaN for one that is not seen, never a guess.

        It is called once for every new frame. In the loop it must take less than a tick; in a
        `TrackingThread` it may take a frame's period. A frame that is damaged: raise BadInput, and
        it is dropped. Any other exception ends the run.
        """
        ...

    def reset(self) -> None:
        """Forget where the markers were: a person may have moved the tool. Called when a run or
        teaching begins."""
        ...


@runtime_checkable
class Explains(Protocol):
    """What a tracker may do beside."""

    def why(self, frame: Frame) -> str:
        """Say in words why the markers are not found in a frame; empty where they are.

        It is asked only after a failure, may be slow, and changes nothing.
        """
        ...
