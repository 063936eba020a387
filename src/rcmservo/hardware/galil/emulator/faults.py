"""What goes wrong with the emulated controller and its wire, on request.

It is written `kind:at=5,for=0.5`: from `at` s after the emulator's start for `for` s, or to the
end.
"""

import math
from dataclasses import dataclass

from rcmservo.constraints import one_of
from rcmservo.errors import require

KINDS = {
    "silence": "it hears nothing and answers nothing, its program goes on",
    "garbage": "it answers with random bytes",
    "half": "it sends only the first half of each answer",
    "slow": "each of its answers comes 0.2 s late",
    "reset": "it is reset, as if its power had failed for a moment",
    "stuck": "its first axis does not move, whatever the motor does",
    "amplifier": "its amplifiers are short of voltage, and let the motors go",
}
"""The kinds, in words."""

LATE = 0.2
"""s by which slow answers come late."""
LONGEST = 1e6


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong."""

    kind: str
    """Its name in KINDS."""
    at: float = 0.0
    """s after the emulator's start."""
    duration: float = math.inf
    """s for which it lasts."""

    def __post_init__(self) -> None:
        one_of(KINDS).require("--fault", self.kind)
        right = f"a time in s from 0 to {LONGEST:g}"
        require(0.0 <= self.at <= LONGEST, f"--fault {self.kind}: at", self.at, right)
        require(self.duration > 0.0, f"--fault {self.kind}: for", self.duration, "a time above 0 s")

    @classmethod
    def parse(cls, text: str) -> "Fault":
        """The fault written as `kind:at=5,for=0.5`."""
        kind, _, rest = text.partition(":")
        times = {"at": 0.0, "for": math.inf}
        for item in rest.split(",") if rest else []:
            key, _, value = (part.strip() for part in item.partition("="))
            require(key in times, f"--fault {kind}", item, "at=SECONDS or for=SECONDS")
            try:
                times[key] = float(value)
            except ValueError:
                require(False, f"--fault {kind}: {key}", value, "a number of s")
        return cls(kind.strip(), times["at"], times["for"])

    def acts(self, seconds: float) -> bool:
        """Whether it acts at a moment."""
        return self.at <= seconds < self.at + self.duration
