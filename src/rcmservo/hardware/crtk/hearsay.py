"""What an arm says of itself, as far as it can be believed.

A stamp of 0 is none. What is older than what was said before, or too old, or from a time to come,
is not taken; nor, for the joints, what bears the same stamp again. That an arm is on is believed of
a newer word alone; that it is off, of one as new. All under one name must come from one writer.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.hardware.crtk.messages import JointState, OperatingState, StringStamped

OLD = 200_000_000
"""ns after which joints are no news."""
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
        self.trouble = ""
        """Why it can be believed no more."""
        self.stale = self.warnings = 0
        """Messages that were not taken, and how often it warned."""
        self._namespace, self._writers = namespace, dict[str, str]()
        self._newest = 0

    @property
    def on(self) -> bool:
        """Whether its drive is on, and it knows where it stands."""
        return self.state is not None and self.state.state == ENABLED and self.state.is_homed

    def hear_joints(self, said: JointState, writer: str, now: int, real: int) -> bool:
        """Take where the joints are; whether it was taken."""
        age, position = real - said.stamp, said.position
        fresh = self._newest < said.stamp and -AHEAD <= age <= OLD
        whole = len(position) >= 3 and len(said.name) in (0, len(position))
        if not (fresh and whole and bool(np.isfinite(position).all())):
            self.stale += 1
            if said.stamp and self.joints is None and not -AHEAD <= age <= OLD:
                self.trouble = (
                    f"the stamps of {self._namespace} are {age * 1e-9:.3f} s old: its clock and "
                    f"this computer's must be the same"
                )
            return False
        if not self._one("measured_js", writer):
            return False
        if self.joints is None:
            self.trouble = ""
        self._newest = said.stamp
        self.joints = ToldJoints(now - max(age, 0), position, said.name)
        return True

    def hear_state(self, said: OperatingState, writer: str, real: int) -> bool:
        """Take how it is; whether it was taken."""
        newest = self.state.stamp if self.state is not None else 0
        newer = newest < said.stamp or (newest == said.stamp and said.state != ENABLED)
        if not (0 < said.stamp <= real + AHEAD and newer):
            self.stale += said != self.state
            return False
        if not self._one("operating_state", writer):
            return False
        self.state = said
        return True

    def hear_warning(self, said: StringStamped, writer: str) -> None:
        """Take what it warns of."""
        self.warnings += 1
        self.warning = said.string

    def _one(self, topic: str, writer: str) -> bool:
        """Whether it is the writer that was heard before."""
        if self._writers.setdefault(topic, writer) == writer:
            return True
        self.trouble = (
            f"two arms speak as {self._namespace}, or it was started again: connect again"
        )
        return False
