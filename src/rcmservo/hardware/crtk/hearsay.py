"""What an arm says of itself, as far as it can be believed.

A stamp of 0 is none. What is older than what was said before, or too old, or from a time to come,
is not taken; nor, for the joints, what bears the same stamp again. That an arm is on is believed of
a newer word alone; that it is off, of one as new. All under one name must come from one writer.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.hardware.crtk.messages import JointState, OperatingState, StringStamped

FRESH = 50_000_000
"""ns for which where the joints are is good enough to move from: what is older is no news."""
AHEAD = 5_000_000
"""ns by which a stamp may be ahead of the clock here: two clocks are read one after the other."""
ENABLED = "ENABLED"


class ToldJoints(NamedTuple):
    """Where an arm told that it is."""

    time: int
    """ns of this computer's clock."""
    position: tuple[float, ...]
    """rad or m of each joint."""
    name: tuple[str, ...]
    """The joints' names."""


class Hearsay:
    """The newest words of one arm. `now` and `real` are this computer's clock and its calendar
    time, ns."""

    def __init__(self, namespace: str) -> None:
        self.joints: ToldJoints | None = None
        self.state: OperatingState | None = None
        self.warning = ""
        """What it warned of last, or how it failed."""
        self.doubts = dict[str, str]()
        """Why what was said last on a topic is not believed."""
        self._several = ""
        self.stale = self.warnings = 0
        """Messages that were not taken, and how often it warned."""
        self._namespace, self._writers = namespace, dict[str, str]()
        self._newest = 0

    @property
    def trouble(self) -> str:
        """Why it can be believed no more."""
        return self._several or ("; ".join(self.doubts.values()) if self.missing else "")

    @property
    def missing(self) -> str:
        """What it has not told yet, in words; empty where it has told all."""
        if self.joints is None:
            return f"nobody tells {self._namespace}/measured_js"
        return f"nobody tells {self._namespace}/operating_state" if self.state is None else ""

    @property
    def on(self) -> bool:
        """Whether its drive is on, and it knows where it stands."""
        return self.powered and self.state is not None and self.state.is_homed

    @property
    def powered(self) -> bool:
        """Whether its drive is on, whatever it knows."""
        return self.state is not None and self.state.state == ENABLED

    def hear_joints(self, said: JointState, writer: str, now: int, real: int) -> bool:
        """Take where the joints are; whether it was taken."""
        if not self._one("measured_js", writer):
            return False
        position = said.position
        whole = len(position) >= 3 and len(said.name) in (0, len(position))
        known = self._dated("measured_js", said.stamp, real, FRESH) and self._newest < said.stamp
        if not (known and whole and bool(np.isfinite(position).all())):
            self.stale += 1
            return False
        self._newest = said.stamp
        self.joints = ToldJoints(now - max(real - said.stamp, 0), position, said.name)
        return True

    def hear_state(self, said: OperatingState, writer: str, real: int) -> bool:
        """Take how it is; whether it was taken."""
        if not self._one("operating_state", writer):
            return False
        newest = self.state.stamp if self.state is not None else 0
        says_on = said.state == ENABLED and said.is_homed
        newer = newest < said.stamp or (newest == said.stamp and not says_on)
        if not (self._dated("operating_state", said.stamp, real, real) and newer):
            self.stale += said != self.state
            return False
        self.state = said
        return True

    def hear_warning(self, said: StringStamped, writer: str) -> None:
        """Take what it warns of."""
        self.warnings += 1
        self.warning = said.string

    def _dated(self, topic: str, stamp: int, real: int, oldest: int) -> bool:
        """Whether a stamp can be, and is not older than so many ns; if not, that is noted."""
        age, name = real - stamp, self._namespace
        if stamp > 0 and -AHEAD <= age <= oldest:
            self.doubts.pop(topic, None)
            return True
        self.doubts[topic] = (
            f"the stamps of {name}/{topic} are {age * 1e-9:.3f} s old: its clock and this "
            f"computer's must be the same, and joints be here within {FRESH * 1e-9:g} s"
            if stamp > 0
            else f"{name}/{topic} bears no stamp, without which it cannot be believed"
        )
        return False

    def _one(self, topic: str, writer: str) -> bool:
        """Whether it is the writer that was heard before."""
        if self._writers.setdefault(topic, writer) == writer:
            return True
        self._several = (
            f"two arms speak as {self._namespace}, or it was started again: connect again"
        )
        return False
