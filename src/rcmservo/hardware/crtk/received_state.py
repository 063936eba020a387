"""Joints and operating state that an arm reports, checked for valid stamps and a single writer.

A stamp is the calendar time at which the arm's computer has measured; 0 is invalid. A message is
rejected if its stamp is older than that of the last one, too old, or in the future; a joint message
also if its stamp repeats. The state ENABLED counts only with a newer stamp, any other state also
with an equal one. All messages on a topic must come from one writer (one process of the network).
"""

from typing import NamedTuple

import numpy as np

from rcmservo.hardware.crtk.messages import JointState, OperatingState, StringStamped

MAX_JOINT_AGE_NS = 50_000_000
"""Largest age of a joint position that motion may be based on."""
MAX_STAMP_LEAD_NS = 5_000_000
"""Largest lead of a stamp over this computer's clock, since two clocks are read in turn."""
ENABLED = "ENABLED"


class ReportedJoints(NamedTuple):
    """Joint position that the arm has reported.

    Parameters
    ----------
    time : int
        Time of the measurement, ns of this computer's clock.
    position : tuple[float, ...]
        Position of each joint in rad or m.
    name : tuple[str, ...]
        Names of the joints.
    """

    time: int
    position: tuple[float, ...]
    name: tuple[str, ...]


class ReceivedState:
    """Newest valid reports of one arm.

    The arguments `now` and `calendar_now` of the methods are the present time in ns on this
    computer's monotonic clock and as calendar time.

    Parameters
    ----------
    namespace : str
        Namespace of the arm.
    """

    def __init__(self, namespace: str) -> None:
        self.joints: ReportedJoints | None = None
        self.state: OperatingState | None = None
        self.warning = ""
        """Last warning or error of the arm."""
        self.invalid_stamps = dict[str, str]()
        """Sentence per topic whose last stamp is invalid."""
        self.rejected = self.warnings = 0
        """Numbers of rejected messages and of warnings."""
        self._second_writer = ""
        self._namespace, self._writers = namespace, dict[str, str]()
        self._newest_stamp = 0

    @property
    def problem(self) -> str:
        """Reason why the reports cannot be used, in a sentence; empty if there is none."""
        invalid_stamps = "; ".join(self.invalid_stamps.values()) if self.missing else ""
        return self._second_writer or invalid_stamps

    @property
    def missing(self) -> str:
        """First topic without a valid report, in a phrase; empty if there is none."""
        if self.joints is None:
            return f"nothing publishes {self._namespace}/measured_js"
        return f"nothing publishes {self._namespace}/operating_state" if self.state is None else ""

    @property
    def is_ready(self) -> bool:
        """True if the drive is on and the arm is homed."""
        return self.is_powered and self.state is not None and self.state.is_homed

    @property
    def is_powered(self) -> bool:
        """True if the drive is on, homed or not."""
        return self.state is not None and self.state.state == ENABLED

    def receive_joints(self, message: JointState, writer: str, now: int, calendar_now: int) -> None:
        """Store a joint position, if it is valid."""
        if not self._is_only_writer("measured_js", writer):
            return
        position, age = message.position, calendar_now - message.stamp
        is_complete = len(position) >= 3 and len(message.name) in (0, len(position))
        has_valid_stamp = self._has_valid_stamp("measured_js", message.stamp, age, MAX_JOINT_AGE_NS)
        is_newer = self._newest_stamp < message.stamp
        if has_valid_stamp and is_newer and is_complete and np.isfinite(position).all():
            self._newest_stamp = message.stamp
            self.joints = ReportedJoints(now - max(age, 0), position, message.name)
        else:
            self.rejected += 1

    def receive_state(self, message: OperatingState, writer: str, calendar_now: int) -> None:
        """Store an operating state, if it is valid."""
        if not self._is_only_writer("operating_state", writer):
            return
        newest_stamp = self.state.stamp if self.state is not None else 0
        is_ready = message.state == ENABLED and message.is_homed
        is_newer = newest_stamp < message.stamp or (newest_stamp == message.stamp and not is_ready)
        age = calendar_now - message.stamp
        if self._has_valid_stamp("operating_state", message.stamp, age, calendar_now) and is_newer:
            self.state = message
        else:
            self.rejected += message != self.state

    def receive_warning(self, message: StringStamped, writer: str) -> None:
        """Count and store a warning or error."""
        self.warnings += 1
        self.warning = message.string

    def _has_valid_stamp(self, topic: str, stamp: int, age: int, max_age: int) -> bool:
        """Check a stamp and its age (ns), and store or clear the topic's sentence."""
        name = self._namespace
        if stamp > 0 and -MAX_STAMP_LEAD_NS <= age <= max_age:
            self.invalid_stamps.pop(topic, None)
            return True
        self.invalid_stamps[topic] = (
            f"the stamps of {name}/{topic} are {age * 1e-9:.3f} s old: synchronise the arm's clock "
            f"with this computer's; joints must arrive within {MAX_JOINT_AGE_NS * 1e-9:g} s"
            if stamp > 0
            else f"{name}/{topic} has no stamp, and is not used without one"
        )
        return False

    def _is_only_writer(self, topic: str, writer: str) -> bool:
        """Return True if the writer is the one of the first message on the topic."""
        if self._writers.setdefault(topic, writer) == writer:
            return True
        self._second_writer = (
            f"two arms publish as {self._namespace}, or the arm was restarted: connect again"
        )
        return False
