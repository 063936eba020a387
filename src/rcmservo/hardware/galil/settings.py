"""Settings of an arm on a Galil controller: the section [arm] with kind = "galil" of a rig file."""

import zlib
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.constraints import Checked, Limit, Triple, between, each, not_empty
from rcmservo.hardware.galil.data_record import AXIS_LETTERS
from rcmservo.interfaces import Floats

MIN_ACCELERATION, MAX_ACCELERATION = 1024, 1073740800
"""Range of AC and DC in counts/s². They take multiples of the minimum."""

PER_JOINT = "three numbers (for rad, rad, mm) of {:g} to {:g}"
POSITIVE_PER_JOINT = each(between(1e-6, 1e6), PER_JOINT.format(1e-6, 1e6))
COUNTS_PER_UNIT = each(
    Limit(lambda count: 1e-3 <= abs(count) <= 1e9, ""),
    PER_JOINT.format(1e-3, 1e9) + ", or negative",
)
THREE_AXES = Limit(
    lambda axes: len(set(axes)) == len(axes) == 3 and set(axes) <= set(AXIS_LETTERS),
    "three different letters of A to H, such as ABC",
)


@dataclass(frozen=True)
class GalilSettings(Checked, section="arm"):
    """Connection and axes of an arm on a Galil DMC-40x0 controller.

    Parameters
    ----------
    address : str
        Host name, IP address, or serial port of the controller, such as /dev/ttyUSB0.
    counts : Triple
        Encoder counts per rad, rad and mm of the joints; negative if the counts fall as the joint
        rises.
    port : int
        TCP port of the controller.
    baud : Literal[9600, 19200, 38400, 115200]
        Bit rate of a serial port, bits/s.
    axes : str
        Axes that drive the first, second and third joint.
    acceleration : Triple
        Acceleration of the joints, rad/s², rad/s², mm/s².
    deceleration : Triple
        Deceleration with which the controller slows down and stops the joints, rad/s², rad/s²,
        mm/s².
    following_error : Triple
        Following error of a joint above which its motor goes off, rad, rad, mm.
    command_timeout : float
        Time in s without a valid command after which the controller stops the arm by itself.
    reply_timeout : float
        Time limit for a reply of the controller, s.
    """

    name: ClassVar[str] = "galil"
    """Kind of the arm in rig files."""

    address: Annotated[str, not_empty("a name or an address")]
    counts: Annotated[Triple, COUNTS_PER_UNIT]
    port: Annotated[int, between(1, 65535, "a whole number")] = 23
    baud: Literal[9600, 19200, 38400, 115200] = 115200
    axes: Annotated[str, THREE_AXES] = "ABC"
    acceleration: Annotated[Triple, POSITIVE_PER_JOINT] = (10.0, 10.0, 1000.0)
    deceleration: Annotated[Triple, POSITIVE_PER_JOINT] = (10.0, 10.0, 1000.0)
    following_error: Annotated[Triple, POSITIVE_PER_JOINT] = (0.02, 0.02, 2.0)
    command_timeout: Annotated[float, between(0.01, 0.05, "a time", "s")] = 0.04
    reply_timeout: Annotated[float, between(0.02, 2.0, "a time", "s")] = 0.25

    @property
    def wiring(self) -> Wiring:
        """Assignment of the joints to the controller's axes."""
        return Wiring(self.counts, axes=self.axes)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("acceleration", "deceleration"):
            counts = self.to_counts(getattr(self, name))
            expected = f"from {MIN_ACCELERATION} to {MAX_ACCELERATION} counts/s² for every joint"
            is_valid = bool(((counts >= MIN_ACCELERATION) & (counts <= MAX_ACCELERATION)).all())
            self.require(is_valid, name, expected)

    @property
    def is_serial(self) -> bool:
        """True if the address is a serial port."""
        return self.address.startswith(("/", "COM"))

    @property
    def scale_checksum(self) -> int:
        """Checksum of `axes` and `counts`, from 1 to 2^31 - 1, which the controller can store."""
        text = f"{self.axes} {' '.join(map(repr, map(float, self.counts)))}"
        return zlib.crc32(text.encode()) % (2**31 - 1) + 1

    def to_counts(self, magnitudes: Triple) -> Floats:
        """Convert magnitudes in the units of the joints (rad, rad, mm) to unsigned counts (3,)."""
        return np.abs(np.array(magnitudes) * np.array(self.counts))

    def stopping_time(self, speeds: Floats) -> float:
        """Return the time in s that the controller needs to stop axes at these counts/s (3,).

        The deceleration is the one that DC has rounded.
        """
        deceleration = self.to_counts(self.deceleration) // MIN_ACCELERATION * MIN_ACCELERATION
        return float((speeds / deceleration).max())
