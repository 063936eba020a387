"""Faults that the emulated Galil controller and its connection show at requested times.

A fault is written as `kind`, `kind:at=5`, `kind:for=0.5` or `kind:at=5,for=0.5`. `at` is its start
in s after the start of the emulator, by default 0. `for` is its duration in s; by default the fault
lasts until the end.
"""

import math
from dataclasses import dataclass

from rcmservo.constraints import one_of
from rcmservo.errors import BadInput, require

FAULT_KINDS = {
    "silence": "receives nothing, so answers nothing, while its program continues",
    "garbage": "replies with random bytes",
    "half": "sends only the first half of each reply",
    "slow": "sends each reply 0.2 s late",
    "reset": "resets once, at the start of the fault, as after a short power failure",
    "stuck": "axis A does not move although its motor is driven",
    "amplifier": "the amplifiers report under-voltage, which switches the motors off",
}
"""Kinds of fault with their descriptions."""

SLOW_REPLY_DELAY_S = 0.2
"""Delay in s of each reply during the fault `slow`."""

MAX_START_TIME_S = 1e6
"""Latest start in s after the start of the emulator; it rejects times in another unit."""


@dataclass(frozen=True)
class Fault:
    """One fault with its start and duration.

    Parameters
    ----------
    kind : str
        Kind of the fault, a key of ``FAULT_KINDS``.
    start : float
        Start in s after the start of the emulator, from 0 to ``MAX_START_TIME_S``.
    duration : float
        Duration in s, positive; inf: until the end.

    Raises
    ------
    BadInput
        If the kind is unknown or a time is outside its range.
    """

    kind: str
    start: float = 0.0
    duration: float = math.inf

    def __post_init__(self) -> None:
        one_of(FAULT_KINDS).require("--fault", self.kind)
        is_start_valid = 0.0 <= self.start <= MAX_START_TIME_S
        expected_start = f"a time in s from 0 to {MAX_START_TIME_S:g}"
        require(is_start_valid, f"--fault {self.kind}: at", self.start, expected_start)
        require(self.duration > 0.0, f"--fault {self.kind}: for", self.duration, "a time above 0 s")

    @classmethod
    def parse(cls, text: str) -> "Fault":
        """Return the fault that a text such as `kind:at=5,for=0.5` describes.

        Parameters
        ----------
        text : str
            Kind, and optionally start and duration in s.

        Returns
        -------
        Fault
            Fault with these values.

        Raises
        ------
        BadInput
            If the text has another form, or a value is outside its range.
        """
        kind, _, options = text.partition(":")
        times_s = {"at": 0.0, "for": math.inf}
        for option in options.split(",") if options else []:
            key, _, value = (part.strip() for part in option.partition("="))
            require(key in times_s, f"--fault {kind}", option, "at=SECONDS or for=SECONDS")
            try:
                times_s[key] = float(value)
            except ValueError:
                raise BadInput(f"--fault {kind}: {key}", value, "a number of seconds") from None
        return cls(kind.strip(), times_s["at"], times_s["for"])

    def is_active(self, time_s: float) -> bool:
        """Return True if the fault acts at a time (s after the start of the emulator)."""
        return self.start <= time_s < self.start + self.duration
