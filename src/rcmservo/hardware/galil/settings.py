"""How an arm's joints hang on a controller's axes: a rig file's section [arm] of the kind galil."""

import zlib
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from rcmservo.bringup.axis_wiring import Wiring
from rcmservo.constraints import Checked, Limit, Triple, between, each, not_empty
from rcmservo.hardware.galil.data_record import LETTERS
from rcmservo.interfaces import Floats

LEAST_RATE, MOST_RATE = 1024, 1073740800
"""counts/s² that AC and DC take, in steps of the least."""

WORDS = "three numbers (for rad, rad, mm) of {:g} to {:g}"
SIZES = each(between(1e-6, 1e6), WORDS.format(1e-6, 1e6))
COUNTS = each(
    Limit(lambda count: 1e-3 <= abs(count) <= 1e9, ""), WORDS.format(1e-3, 1e9) + ", or negative"
)
AXES = Limit(
    lambda axes: len(set(axes)) == len(axes) == 3 and set(axes) <= set(LETTERS),
    "three different letters of A to H, such as ABC",
)


@dataclass(frozen=True)
class GalilSettings(Checked, section="arm"):
    """A Galil DMC-40x0 and what hangs on it."""

    name: ClassVar[str] = "galil"
    """Its kind in rig files."""

    address: Annotated[str, not_empty("a name or an address")]
    """Its name or number on the network, or the serial port that it hangs on, such as
    /dev/ttyUSB0."""
    counts: Annotated[Triple, COUNTS]
    """Encoder counts of a rad, rad and mm of the joints; negative where counts fall as it rises."""
    port: Annotated[int, between(1, 65535, "a whole number")] = 23
    """Its port on the network."""
    baud: Literal[9600, 19200, 38400, 115200] = 115200
    """bits/s of a serial port."""
    axes: Annotated[str, AXES] = "ABC"
    """The axes that drive the first, the second and the third joint."""
    acceleration: Annotated[Triple, SIZES] = (10.0, 10.0, 1000.0)
    """rad/s², rad/s², mm/s² with which speeds are gained."""
    deceleration: Annotated[Triple, SIZES] = (10.0, 10.0, 1000.0)
    """rad/s², rad/s², mm/s² with which the controller stops the joints."""
    following_error: Annotated[Triple, SIZES] = (0.02, 0.02, 2.0)
    """rad, rad, mm by which a joint may lag behind before its motor goes off."""
    patience: Annotated[float, between(0.01, 0.05, "a time", "s")] = 0.04
    """s without a valid command after which the controller stops the arm by itself."""
    answer_within: Annotated[float, between(0.02, 2.0, "a time", "s")] = 0.25
    """s within which it must answer."""

    @property
    def wiring(self) -> Wiring:
        """How the joints hang on the controller's motors."""
        return Wiring(self.counts, axes=self.axes)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("acceleration", "deceleration"):
            rates = self.in_counts(getattr(self, name))
            right = f"from {LEAST_RATE} to {MOST_RATE} counts/s² for every joint"
            inside = bool(((rates >= LEAST_RATE) & (rates <= MOST_RATE)).all())
            self.require(inside, name, right)

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

    def in_counts(self, joints: Triple) -> Floats:
        """Sizes of joint motions (3,) in counts, without signs."""
        return np.abs(np.array(joints) * np.array(self.counts))

    def rest_time(self, speeds: Floats) -> float:
        """s in which the controller brings axes with these counts/s (3,) to rest, by the DC that
        it takes of the deceleration."""
        slowing = self.in_counts(self.deceleration) // LEAST_RATE * LEAST_RATE
        return float((speeds / slowing).max())
