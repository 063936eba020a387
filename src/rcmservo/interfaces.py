"""Interfaces between devices and servo: protocols of the devices and the data that they exchange.

Time is integer nanoseconds on the plant's clock. Pixel (0, 0) is the centre of the top left pixel;
u points right, v down.
"""

from dataclasses import dataclass, field
from enum import IntEnum
from numbers import Integral, Real
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rcmservo.errors import BadInput, require
from rcmservo.numerics.structs import Floats, make_struct_reader, make_tuple_struct

Image = NDArray[np.uint8]
"""Image (height, width, 3) in blue, green, red, as in OpenCV."""

JointArray = Annotated[Floats, (3,)]
"""Array (3,) with one number for each joint."""

MarkerArray = Annotated[Floats, (2, 2)]
"""Array (2, 2) with the pixels (u, v) of both markers."""

NEVER_NS = -(1 << 62)
"""Time (ns) of an event that has not happened. It is before all times of a clock of any origin."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of a camera.

    Times are on the plant's `Clock`. Pixel (0, 0) is the centre of the top left pixel; u points
    right, v down.

    A camera with images fills `image`; a simulated camera that reports only the markers fills
    `points`.

    Parameters
    ----------
    number : int
        Frame number, which rises from frame to frame; it may start again after 16, 31 or 32 bits.
    exposure : int
        Middle of the exposure, ns.
    arrival : int
        Time at which the computer received the frame, ns.
    image : Image or None
        Image (height, width, 3), uint8, blue-green-red as in OpenCV. None if there is none, or if
        it arrived damaged.
    points : Floats or None
        Markers (2, 2) in px: m1 and m2, NaN if hidden. None for a camera with images.
    """

    number: int
    exposure: int
    arrival: int
    image: Image | None = None
    points: Floats | None = None


@dataclass(frozen=True, eq=False)
class Markers:
    """Markers that a tracker detected in a frame.

    Parameters
    ----------
    points : Floats
        Centres (2, 2) in px: row 0 is m1 (nearer the RCM), row 1 is m2 (nearer the tip). NaN for a
        lost marker, never a guess.
    radius : Floats
        Radii (2,) of the imaged markers in px; NaN if unknown.
    quality : Floats
        Detection quality (2,) from 0 (lost) to 1.
    covariance : Floats
        Covariance (2, 3, 3) in px² of the noise in u, v and radius of each marker; NaN if lost or
        unknown. By default all NaN. Errors that are the same in every frame are not part of it.
    """

    points: Floats
    radius: Floats
    quality: Floats
    covariance: Floats = field(default_factory=lambda: np.full((2, 3, 3), np.nan))


class DropReason(IntEnum):
    """Reason for not using the newest frame of a camera; its ``text`` describes it to the operator.

    Attributes
    ----------
    NONE
        The frame is used.
    NOT_NEW
        Its number is not above that of the previous frame.
    CLOCK
        Its exposure or arrival is at an impossible time, or its exposure is not later than that of
        the previous frame. A time is impossible if the frame arrived before its exposure or more
        than 2 s after it, or if the arrival is in the future or more than 2 s ago.
    DAMAGED
        Its image arrived damaged.
    """

    _value_: int
    text: str

    def __new__(cls, text: str) -> Self:
        code = len(cls.__members__)
        member = int.__new__(cls, code)
        member._value_, member.text = code, text
        return member

    NONE = ""
    NOT_NEW = "the frames arrive repeatedly or out of order"
    CLOCK = "the frames have impossible timestamps"
    DAMAGED = "the frames arrive damaged"


@dataclass(frozen=True, eq=False)
class Observation:
    """Input of the servo at one tick. Times are ns on the plant's clock.

    Parameters
    ----------
    now : int
        Time of the observation.
    q : JointArray
        Joint values (3,) in rad, rad, mm that the arm reported last.
    q_time : int
        Time at which the arm read them.
    enabled : bool
        True while the arm's drive is on.
    applied : JointArray
        Joint rates (3,) in rad/s, rad/s, mm/s that the arm applied of the last command; zeros
        before the first.
    frame : int
        Number of the newest frame used; -1 before the first.
    exposure : int
        Middle of that frame's exposure; 0 before the first.
    arrival : int
        Time at which the computer received that frame; 0 before the first.
    q_exposure : JointArray
        Joint values (3,) at the exposure; NaN if unknown.
    points : MarkerArray
        Raw markers (2, 2) in px in that frame; NaN if lost. Row 0 is marker 1, the one nearer the
        RCM; the columns are (u, v).
    drop_reason : DropReason
        Reason for not using the newest frame, a member of `rcmservo.interfaces.DropReason`: NONE
        (the default) if it was used; NOT_NEW if its number is not above that of the previous frame;
        CLOCK for an impossible time; DAMAGED for a damaged image. A time is impossible if the frame
        arrived before its exposure or more than 2 s after it, if the arrival is later than `now` or
        more than 2 s before it, or if the exposure is not later than that of the previous frame.
    recorded : bool
        False once a requested record is no longer written; True by default.
    sizes : Floats
        Apparent radii (2,) of the markers in px; NaN, the default, if lost or unknown.
    quality : Floats
        Detection quality (2,) from 0 (lost) to 1; NaN, the default, if unknown. It is displayed and
        recorded; no motion depends on it.
    """

    now: int
    q: JointArray
    q_time: int
    enabled: bool
    applied: JointArray
    frame: int
    exposure: int
    arrival: int
    q_exposure: JointArray
    points: MarkerArray
    drop_reason: DropReason = DropReason.NONE
    recorded: bool = True
    sizes: Floats = field(default_factory=lambda: np.full(2, np.nan))
    quality: Floats = field(default_factory=lambda: np.full(2, np.nan))


if TYPE_CHECKING:
    ObservationStruct = Observation
else:
    ObservationStruct = make_tuple_struct(Observation, without=("sizes", "quality"))

observation_numbers = make_struct_reader(Observation, ObservationStruct)
"""Function that reads the numbers of an `ObservationStruct` from an `Observation`."""


@dataclass(frozen=True, eq=False)
class Command:
    """Joint rates for the arm. Only the gate makes a command.

    Parameters
    ----------
    number : int
        Command number, which rises from command to command.
    time : int
        Time of its tick, ns.
    deadline : int
        Time (ns) after which the command is void. An arm without a newer command then stops and
        disables its drive.
    rates : JointArray
        Joint rates (3,) in rad/s, rad/s, mm/s.
    enabled : bool
        False disables the arm's drive at once.
    """

    number: int
    time: int
    deadline: int
    rates: JointArray
    enabled: bool


@dataclass(frozen=True, eq=False)
class Target:
    """Taught pose, which `teach` returns.

    The servo computes the desired features y_d = [s r d] (3,) in rad, px, px from it, eq. (7)-(9).
    With the markers (u₁, v₁) and (u₂, v₂) px measured from the present imaged RCM these are

        s = atan2(v₂ − v₁, u₂ − u₁),    r = |(u₁, v₁)|,    d = |(u₂ − u₁, v₂ − v₁)|

    Parameters
    ----------
    points : Floats
        Raw markers (2, 2) in px. Row 0 is marker 1, the one nearer the RCM; the columns are (u, v).
    q : Floats
        Joint values (3,) in rad, rad, mm during teaching; NaN if unknown. In a direction that the
        image hardly shows the servo moves to them, as ``joint_trust`` of the controller
        determines. It also compares them to detect a pose that only looks like the target, and
        stops.
    taught_at : int
        Time at which teaching began, ns on the plant's clock (0: before all known times). The servo
        refuses a target that was taught before the camera was moved.
    sizes : Floats
        Apparent radii (2,) of the markers in px during teaching; NaN, the default, if unknown.
    left_out : int
        Number of frames that teaching left out because their markers were elsewhere. It is no part
        of a comparison, and files do not hold it.
    swing_px : float
        Amplitude in px of a slow motion of both markers while they were taught with the joints at
        rest, as by a port that moves with the breath or a moving camera; 0 if there was none. It is
        no part of a comparison, and files do not hold it.

    Raises
    ------
    BadInput
        If an array has another shape or holds no numbers, if a pixel is not finite, or if
        `taught_at` is no whole number.

    Notes
    -----
    The arrays are copied, and lists of numbers are accepted. Targets with the same numbers are
    equal.

    With an estimator that determines the imaged RCM (dlt, affine), s is the angle of the line
    through the imaged RCM that passes nearest to both markers, and r and d are measured along it.

    References
    ----------
    Section II-D of the paper.
    """

    points: Floats
    q: Floats
    taught_at: int = 0
    sizes: Floats = field(default_factory=lambda: np.full(2, np.nan))
    left_out: int = 0
    swing_px: float = 0.0

    def __post_init__(self) -> None:
        for name, shape in {"points": (2, 2), "q": (3,), "sizes": (2,)}.items():
            array = _copy_as_floats(f"target.{name}", getattr(self, name), shape)
            object.__setattr__(self, name, array)
        is_finite = bool(np.isfinite(self.points).all())
        expected = "finite pixels (u, v) of both markers"
        require(is_finite, "target.points", self.points.tolist(), expected)
        for name, kind in {"taught_at": "a time in whole ns", "left_out": "a whole number"}.items():
            value: Any = getattr(self, name)
            is_whole = isinstance(value, Integral)
            require(is_whole, f"target.{name}", value, kind)
        is_number = isinstance(self.swing_px, Real) and self.swing_px >= 0.0
        require(is_number, "target.swing_px", self.swing_px, "a number that is not negative")

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Target) and self._numbers == other._numbers)

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def swing_text(self) -> str:
        """Sentence on the motion of the markers while they were taught; empty if there was none."""
        return describe_swing(self.swing_px) if self.swing_px > 0.0 else ""

    @property
    def _numbers(self) -> tuple[bytes, int]:
        """All numbers; NaN is equal to NaN."""
        arrays = self.points, self.q, self.sizes
        return b"".join(np.nan_to_num(a, nan=np.inf).tobytes() for a in arrays), self.taught_at


def describe_swing(swing_px: float) -> str:
    """Return a sentence on markers that move by an amplitude in px while the joints rest."""
    return (
        f"while teaching, both markers moved by ±{swing_px:.1f} px with the joints at rest: does "
        "the port move with the breath, or the camera?"
    )


def _copy_as_floats(field: str, value: object, shape: tuple[int, ...]) -> Floats:
    """Return a new array of a shape, as compiled functions expect it."""
    expected = f"numbers in an array {shape}"
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadInput(field, value, expected) from error
    require(array.shape == shape, field, value, expected)
    return array


class Clock(Protocol):
    """Clock of the plant in whole ns. It never goes back.

    All times of frames, joint readings, observations, commands and targets are on it. In
    simulation, time passes only while the program waits. On hardware the clock is `WallClock`, the
    computer's time since it was started.
    """

    def now(self) -> int:
        """Return the present time without waiting."""
        ...

    def wait_until(self, time: int) -> None:
        """Wait until a time; return at once if it is past. The loop calls it once per tick."""
        ...


class ArmMeasurement(NamedTuple):
    """State that an arm reported last.

    Parameters
    ----------
    time : int
        Time at which the joints were read, ns on the plant's clock.
    q : Floats
        Joint values (3,) in rad, rad, mm.
    enabled : bool
        True while the drive is on.
    """

    time: int
    q: Floats
    enabled: bool


class Arm(Protocol):
    """Arm with velocity drives and its own watchdog.

    The loop calls `measure` and `apply` once per tick (at `Servo.rate`, 100 Hz). Both must return
    within a millisecond. If the arm does not answer, return its last state: the servo stops with a
    fault once that state is too old. An exception ends the run: the loop stops the arm and raises
    the exception to the caller.
    """

    def enable(self) -> None:
        """Enable the drive, at rest, before the first tick of a run. A user's action causes it.

        The call may block until the drive is on. `measure` must report it within 2 s after the
        return. Raise an error that gives the reason if the drive cannot be enabled.
        """
        ...

    def measure(self) -> ArmMeasurement:
        """Return the last reported state without waiting, the same one until the next arrives.

        Its time is that at which the joints were read, on the plant's clock. The method is also
        called while nothing moves: during teaching, with the drive off.
        """
        ...

    def apply(self, command: Command) -> Floats:
        """Send a command without waiting.

        A command that is not ``enabled`` disables the drive. A command is valid until its deadline.
        The arm itself must stop and disable its drive if no newer command arrives by then, even
        after this program has died.

        Returns
        -------
        Floats
            Joint rates (3,) in rad/s, rad/s, mm/s that the arm applies, as far as known: reduced
            ones if it limits them, zeros if it refuses the command.
        """
        ...


class Camera(Protocol):
    """Camera that delivers frames at its own rate.

    The loop calls `latest` every tick (100 Hz). A `TrackingThread`, a class of the module
    `rcmservo.live.tracking_thread`, calls it every millisecond in the loop's place. An exception
    ends the run: the loop stops the arm and raises the exception to the caller. In a
    `TrackingThread` that has offered a frame before, the frames end instead: the servo holds with
    the cause STALE, and the end of the thread's context raises the exception.
    """

    def latest(self) -> Frame | None:
        """Return the newest frame without waiting; None before the first.

        It is the same object until the next frame arrives. If the camera does not answer, return
        the last frame again: as it ages, the servo slows down, holds and pauses. Frame numbers
        rise. Exposure and arrival are on the plant's clock: a driver converts the times of a camera
        with its own clock.
        """
        ...


class Tracker(Protocol):
    """Detector of the marker centres in frames. It may track the markers from frame to frame."""

    def find(self, frame: Frame) -> Markers:
        """Return the markers in a frame; NaN for one that is not detected, never a guess.

        The method is called once for every new frame. In the loop it must take less than a tick, in
        a `TrackingThread` less than the period of the frames. An exception other than `BadInput`
        ends the run.

        Raises
        ------
        BadInput
            If the frame is damaged. The plant then drops it.
        """
        ...

    def reset(self) -> None:
        """Discard the tracked positions, because the tool may have been moved.

        The loop calls it at the beginning of a run and of teaching.
        """
        ...


@runtime_checkable
class FailureExplainer(Protocol):
    """Tracker that gives the reason for a failed detection."""

    def explain_failure(self, frame: Frame) -> str:
        """Return the reason for undetected markers in a frame, in a sentence; empty if detected.

        The method is called only after a failure. It may be slow and changes nothing.
        """
        ...
