"""How an arm's joints hang on a controller's axes: a rig file's section [arm] of the kind galil."""

import zlib
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.errors import require
from rcmservo.hardware.galil.data_record import LETTERS
from rcmservo.interfaces import Floats

LEAST_RATE, MOST_RATE = 1024, 1073740800
"""counts/s² that AC and DC take, in steps of the least."""

Joints = tuple[float, float, float]


@dataclass(frozen=True)
class GalilSettings:
    """A Galil DMC-40x0 and what hangs on it."""

    name: ClassVar[str] = "galil"
    """Its kind in rig files."""

    address: str
    """Its name or number on the network, or the serial port that it hangs on, such as
    /dev/ttyUSB0."""
    counts: Joints
    """Encoder counts of a rad, rad and mm of the joints; negative where counts fall as it rises."""
    port: int = 23
    """Its port on the network."""
    baud: int = 115200
    """bits/s of a serial port."""
    axes: str = "ABC"
    """The axes that drive the first, the second and the third joint."""
    acceleration: Joints = (10.0, 10.0, 1000.0)
    """rad/s², rad/s², mm/s² with which speeds are gained."""
    deceleration: Joints = (10.0, 10.0, 1000.0)
    """rad/s², rad/s², mm/s² with which the controller stops the joints."""
    following_error: Joints = (0.02, 0.02, 2.0)
    """rad, rad, mm by which a joint may lag behind before its motor goes off."""
    patience: float = 0.04
    """s without a valid command after which the controller stops the arm by itself."""
    answer_within: float = 0.25
    """s within which it must answer."""

    @property
    def wiring(self) -> Wiring:
        """How the joints hang on the controller's motors."""
        return Wiring(self.counts, axes=self.axes)

    def __post_init__(self) -> None:
        require(bool(self.address.strip()), "arm.address", self.address, "a name or an address")
        require(0 < self.port < 65536, "arm.port", self.port, "a whole number from 1 to 65535")
        right = "9600, 19200, 38400 or 115200 bits/s"
        require(self.baud in (9600, 19200, 38400, 115200), "arm.baud", self.baud, right)
        good = len(set(self.axes)) == len(self.axes) == 3 and set(self.axes) <= set(LETTERS)
        require(good, "arm.axes", self.axes, "three different letters of A to H, such as ABC")
        _numbers("counts", self.counts, 1e-3, 1e9, signed=True)
        for name in ("acceleration", "deceleration", "following_error"):
            _numbers(name, getattr(self, name), 1e-6, 1e6)
        for name in ("acceleration", "deceleration"):
            rates = self.in_counts(getattr(self, name))
            right = f"from {LEAST_RATE} to {MOST_RATE} counts/s² for every joint"
            inside = bool(((rates >= LEAST_RATE) & (rates <= MOST_RATE)).all())
            require(inside, f"arm.{name}", getattr(self, name), right)
        require(0.01 <= self.patience <= 0.05, "arm.patience", self.patience, "from 0.01 to 0.05 s")
        right = "from 0.02 to 2 s"
        require(0.02 <= self.answer_within <= 2.0, "arm.answer_within", self.answer_within, right)

    @property
    def serial(self) -> bool:
        """Whether it hangs on a serial port."""
        return self.address.startswith(("/", "COM"))

    @property
    def scale_number(self) -> int:
        """A number that tells these counts and axes from others; never 0, and one that the
        controller can keep."""
        told = f"{self.axes} {' '.join(map(repr, map(float, self.counts)))}"
        return zlib.crc32(told.encode()) % (2**31 - 1) + 1

    def in_counts(self, joints: Joints) -> Floats:
        """Sizes of joint motions (3,) in counts, without signs."""
        return np.abs(np.array(joints) * np.array(self.counts))

    def rest_time(self, speeds: Floats) -> float:
        """s in which the controller brings axes with these counts/s (3,) to rest, by the DC that
        it takes of the deceleration."""
        slowing = self.in_counts(self.deceleration) // LEAST_RATE * LEAST_RATE
        return float((speeds / slowing).max())


def _numbers(name: str, values: Joints, least: float, most: float, signed: bool = False) -> None:
    sizes = [abs(value) if signed else value for value in values]
    good = len(values) == 3 and all(least <= size <= most for size in sizes)
    right = f"three numbers (for rad, rad, mm) of {least:g} to {most:g}"
    require(good, f"arm.{name}", values, right + (", or negative" if signed else ""))
