"""What the servo sees of the world and does to it: frames, observations, commands, targets, and the
devices' Protocols.

Time is integer nanoseconds on the plant's clock. A pixel (0, 0) is the centre of the top left
pixel, u right, v down.
"""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of a camera.

    A camera that makes pictures fills `image` ((height, width, 3) uint8, blue-green-red as in
    OpenCV); one that simulates only the markers fills `points` ((2, 2) px: m1 and m2, NaN where
    unseen). Times in ns:
    `exposure` is the middle of the exposure, `arrival` the moment at which the host had the frame.
    """

    number: int
    exposure: int
    arrival: int
    image: Image | None = None
    points: Floats | None = None


@dataclass(frozen=True, eq=False)
class Markers:
    """Where a tracker saw the two markers.

    `points` (2, 2) px: row 0 is m1 (nearer the RCM), row 1 is m2 (nearer the tip); NaN where lost,
    never a guess. `radius` (2,) px of the imaged marker; `quality` (2,) from 0 (lost) to 1.
    """

    points: Floats
    radius: Floats
    quality: Floats


class Dropped(Enum):
    """Why the newest frame that a camera offered was not used."""

    NONE = ""
    NOT_NEW = "frames come repeated or out of order"
    CLOCK = "frames bear times that cannot be right"
    DAMAGED = "frames come damaged"


@dataclass(frozen=True, eq=False)
class Observation:
    """All that a servo is told at one tick. Times are ns on the plant's clock.

    Of the arm: ``q`` (3,) the joints as it last told them, at ``q_time``; ``enabled``, whether its
    drive is on; ``applied`` (3,), the joint rates that it took of the last command.
    Of the camera: ``points`` (2, 2) raw px of the newest frame used, NaN where lost, with its
    ``frame`` number (-1 before the first), ``exposure`` and ``arrival``, and ``q_exposure`` (3,),
    the joints at that moment; ``dropped``, why the frame offered last was not used.
    ``recorded`` is False once a record that was asked for is no longer written.
    """

    now: int
    q: Floats
    q_time: int
    enabled: bool
    applied: Floats
    frame: int
    exposure: int
    arrival: int
    q_exposure: Floats
    points: Floats
    dropped: Dropped = Dropped.NONE
    recorded: bool = True


@dataclass(frozen=True, eq=False)
class Command:
    """What an arm is to do: joint rates (3,) in rad/s, rad/s, mm/s. Only the gate makes one.

    ``number`` rises from command to command; ``time`` ns is that of the tick. After its
    ``deadline`` ns a command is void, and an arm that has no newer one stops and switches its drive
    off. ``enabled`` False switches it off at once.
    """

    number: int
    time: int
    deadline: int
    rates: Floats
    enabled: bool


@dataclass(frozen=True, eq=False)
class Target:
    """What was shown: the markers' raw pixels (2, 2). y_d is computed from them about the imaged
    RCM as known later.

    `q` (3,) are the joints while it was shown. No motion is decided by them; they tell afterwards
    whether a pose that looks the same is the same. `shown` is when that began, ns on the plant's
    clock (0: earlier than all that is known): a target from before the camera was moved is refused.
    """

    points: Floats
    q: Floats
    shown: int = 0


class Clock(Protocol):
    """The plant's time. In simulation it passes only while somebody waits."""

    def now(self) -> int: ...

    def wait_until(self, time: int) -> None: ...


class Measured(NamedTuple):
    """An arm's last answer: the joints q (3,) at ``time`` ns, and whether its drive is
    ``enabled``."""

    time: int
    q: Floats
    enabled: bool


class Arm(Protocol):
    """An arm with velocity drives and a watchdog of its own.

    ``enable`` switches the drive on, at rest: a person's act. ``measure`` gives the last answer at
    once, the same until the next. ``apply`` passes a command on and gives the joint rates (3,) that
    the arm takes of it.
    """

    def enable(self) -> None: ...

    def measure(self) -> Measured: ...

    def apply(self, command: Command) -> Floats: ...


class Camera(Protocol):
    """A camera at its own pace: `latest` gives the newest frame that has arrived, the same until
    the next, or None."""

    def latest(self) -> Frame | None: ...


class Tracker(Protocol):
    """Frames to marker centres. It may remember where the markers were; `reset` makes it forget."""

    def find(self, frame: Frame) -> Markers: ...

    def reset(self) -> None: ...


@runtime_checkable
class Explains(Protocol):
    """What a tracker may do beside: say in words why it does not find the markers in a frame.

    `why` is empty where they are found. It changes nothing, may be slow, and is asked only after
    a failure.
    """

    def why(self, frame: Frame) -> str: ...
