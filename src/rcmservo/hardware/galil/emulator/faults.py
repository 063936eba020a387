"""Faults of the emulated Galil controller and its connection, on request.

A fault is written as `kind:at=5,for=0.5`: it begins `at` s after the start of the emulator and
lasts `for` s, or without `for` until the end.
"""

import math
from dataclasses import dataclass

from rcmservo.constraints import one_of
from rcmservo.errors import require

FAULT_KINDS = {
    "silence": "receives and sends nothing while its program continues",
    "garbage": "replies with random bytes",
    "half": "sends only the first half of each reply",
    "slow": "sends each reply 0.2 s late",
    "reset": "resets, as after a short power failure",
    "stuck": "the first axis does not move while its motor is driven",
    "amplifier": "under-voltage of the amplifiers switches the motors off",
}
"""Kinds of fault with their descriptions."""

SLOW_REPLY_DELAY_S = 0.2
MAX_START_TIME_S = 1e6


@dataclass(frozen=True)
class Fault:
    """One fault with its start and duration.

    Parameters
    ----------
    kind : str
        Kind of the fault, a key of ``FAULT_KINDS``.
    at : float
        Start in s after the start of the emulator.
    duration : float
        Duration in s.
    """

    kind: str
    at: float = 0.0
    duration: float = math.inf

    def __post_init__(self) -> None:
        one_of(FAULT_KINDS).require("--fault", self.kind)
        expected = f"a time in s from 0 to {MAX_START_TIME_S:g}"
        is_valid = 0.0 <= self.at <= MAX_START_TIME_S
        require(is_valid, f"--fault {self.kind}: at", self.at, expected)
        require(self.duration > 0.0, f"--fault {self.kind}: for", self.duration, "a time above 0 s")

    @classmethod
    def parse(cls, text: str) -> "Fault":
        """Parse a fault written as `kind:at=5,for=0.5`."""
        kind, _, options = text.partition(":")
        times = {"at": 0.0, "for": math.inf}
        for option in options.split(",") if options else []:
            key, _, value = (part.strip() for part in option.partition("="))
            require(key in times, f"--fault {kind}", option, "at=SECONDS or for=SECONDS")
            try:
                times[key] = float(value)
            except ValueError:
                require(False, f"--fault {kind}: {key}", value, "a number of s")
        return cls(kind.strip(), times["at"], times["for"])

    def is_active(self, seconds: float) -> bool:
        """Return True if the fault is active at a time (s after the start of the emulator)."""
        return self.at <= seconds < self.at + self.duration
