"""What the servo sees of the world and does to it: frames, observations, commands, targets, and the devices' Protocols.

Time is integer nanoseconds on the plant's clock. A pixel (0, 0) is the centre of the top left pixel, u right, v down.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of a camera.

    A camera that makes pictures fills `image` ((height, width, 3) uint8, blue-green-red as in OpenCV); one that
    simulates only the markers fills `points` ((2, 2) px: m1 and m2, NaN where unseen). Times in ns:
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

    `points` (2, 2) px: row 0 is m1 (nearer the RCM), row 1 is m2 (nearer the tip); NaN where lost, never a guess.
    `radius` (2,) px of the imaged marker; `quality` (2,) from 0 (lost) to 1.
    """

    points: Floats
    radius: Floats
    quality: Floats


@dataclass(frozen=True, eq=False)
class Observation:
    """All that a servo is told at one tick.

    `now` ns; `q` (3,) the joints measured now; `points` (2, 2) raw px of the newest frame, NaN where lost, with its
    `frame` number (-1 before the first), its `exposure` ns and `q_exposure` (3,), the joints at that moment.
    """

    now: int
    q: Floats
    frame: int
    exposure: int
    q_exposure: Floats
    points: Floats


@dataclass(frozen=True, eq=False)
class Command:
    """Joint rates (3,) in rad/s, rad/s, mm/s, a rising number, and the time ns of the tick. Only the gate makes one."""

    number: int
    time: int
    rates: Floats


@dataclass(frozen=True, eq=False)
class Target:
    """What was shown: the markers' raw pixels (2, 2). y_d is computed from them about the imaged RCM as known later.

    `q` (3,) are the joints while it was shown. No motion is decided by them; they tell afterwards whether a pose that
    looks the same is the same.
    """

    points: Floats
    q: Floats


class Clock(Protocol):
    """The plant's time. In simulation it passes only while somebody waits."""

    def now(self) -> int: ...

    def wait_until(self, time: int) -> None: ...


class Mechanism(Protocol):
    """An arm with velocity drives: `measure` gives time ns and joints (3,), `apply` what was applied of a command."""

    def measure(self) -> tuple[int, Floats]: ...

    def apply(self, command: Command) -> Floats: ...


class Camera(Protocol):
    """A camera at its own pace: `latest` gives the newest frame that has arrived, the same until the next, or None."""

    def latest(self) -> Frame | None: ...


class Tracker(Protocol):
    """Frames to marker centres. It may remember where the markers were; `reset` makes it forget."""

    def find(self, frame: Frame) -> Markers: ...

    def reset(self) -> None: ...
