"""Requests of an operator between two ticks, and the servo, target and request of the next tick.

No request restarts the drive. A changed target or setting applies from the next tick on and begins
a new stage in the record.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, array
from rcmservo.errors import require
from rcmservo.interfaces import Command, Floats, Observation, Target
from rcmservo.loop.target_frames import FRAMES, TEACHING_FRAMES, TargetFrames
from rcmservo.loop.tick import Tick
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo

REST_TIME_NS = 200_000_000
"""Time in ns from the first command of zero rates until the tool counts as at rest."""

FIXED_PARTS = ("mechanism", "tool", "estimator", "imaged_rcm", "rate")
"""Parts of a servo that cannot change during a run, as the estimate depends on them."""


@dataclass(frozen=True)
class Teach(Checked):
    """Request to pause and teach the present pose as the target.

    The tool stands still until enough frames show both markers, or until the next request. It then
    stays paused until the operator resumes.

    Parameters
    ----------
    frames : int
        Number of frames whose mean becomes the target.
    """

    frames: Annotated[int, FRAMES] = TEACHING_FRAMES


STILL = np.zeros(3)
"""Joint rates of an arm at rest."""


@dataclass(frozen=True, eq=False)
class Jog(Checked, section="jog"):
    """Request to move the joints at given rates until the next tick, in IDLE or PAUSED, each at no
    more than a fifth of its limit.

    The request must be repeated after every tick. Otherwise the arm comes to rest and the servo
    pauses.

    Parameters
    ----------
    rates : Floats
        Joint rates (3,) rad/s, rad/s, mm/s.
    """

    rates: Annotated[Floats, array(3)]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "rates", np.array(self.rates, dtype=np.float64))


OperatorRequest = Request | Target | Servo | Teach | Jog
"""Request between two ticks: pause, resume or clear; another target; other settings; teaching of
the present pose; jogging."""

Operator = Callable[[Tick], OperatorRequest]
"""Function that the loop calls after every tick for the operator's request. It must not wait."""


@dataclass
class TeachingInRun:
    """Teaching of a target during a run.

    Parameters
    ----------
    frames : int
        Number of frames requested.
    since : int or None
        Time of the first command of zero rates, ns; None while the tool moves.
    shown : TargetFrames
        Frames so far.
    last : int
        Number of the newest frame examined.
    """

    frames: int
    since: int | None = None
    shown: TargetFrames = field(default_factory=TargetFrames)
    last: int = -1

    def add(self, seen: Observation, command: Command) -> Target | None:
        """Add the frame of a tick; return the target once enough frames agree."""
        if command.rates.any():
            self.since = None
        elif self.since is None:
            self.since = seen.now
        if self.since is None or seen.frame == self.last:
            return None
        self.last = seen.frame
        if seen.exposure >= self.since + REST_TIME_NS and np.isfinite(seen.points).all():
            self.shown.add(seen)
        if len(self.shown.points) < self.frames:
            return None
        if self.shown.disagreement():
            self.shown = TargetFrames()
            return None
        return self.shown.target(self.since)


class NextTick:
    """Servo, target and request of the next tick, which an operator may change between two ticks.

    Parameters
    ----------
    servo : Servo
        Settings at the start.
    target : Target
        Target at the start.
    operator : Operator or None
        Source of the requests.
    """

    def __init__(self, servo: Servo, target: Target, operator: Operator | None) -> None:
        self.servo, self.target, self.request, self.jog = servo, target, Request.NONE, STILL
        self._operator = operator
        self._showing: TeachingInRun | None = None

    def steer(self, tick: Tick) -> None:
        """Request the operator's input after a tick and prepare the next tick."""
        self.request, self.jog = Request.NONE, STILL
        if self._operator is None:
            return
        want = self._operator(tick)
        if want is not Request.NONE:
            self._showing = None
            self._set(want)
        if self._showing is not None:
            self._show(self._showing, tick)

    def _set(self, want: OperatorRequest) -> None:
        match want:
            case Request():
                require(want is not Request.JOG, "operator()", want, "a Jog, with the joint rates")
                self.request = want
            case Jog():
                self.request, self.jog = Request.JOG, want.rates
            case Target():
                self._aim(want)
            case Servo():
                want.demand(self.target)
                self.servo = changed_servo(self.servo, want)
            case Teach():
                self.request, self._showing = Request.PAUSE, TeachingInRun(want.frames)
            case _:
                require(False, "operator()", want, "a Request, Target, Servo, Teach or Jog")

    def _show(self, showing: TeachingInRun, tick: Tick) -> None:
        target = showing.add(tick.seen, tick.state.command)
        if target is not None:
            self._showing = None
            self._aim(target)

    def _aim(self, target: Target) -> None:
        """Set another target. The same numbers change nothing."""
        if not same(target, self.target):
            self.servo.demand(target)
            self.target = target


def same(one: Target, other: Target) -> bool:
    """Return True if two targets are equal to the last bit."""
    return (
        one.points.tobytes() == other.points.tobytes()
        and one.q.tobytes() == other.q.tobytes()
        and one.shown == other.shown
        and np.array_equal(one.sizes, other.sizes, equal_nan=True)
    )


def changed_servo(before: Servo, after: Servo) -> Servo:
    """Return a servo with changed settings if the present estimate remains valid for it.

    Raises
    ------
    BadInput
        If a part differs that cannot change during a run.
    """
    for name in FIXED_PARTS:
        value = getattr(after, name)
        present = getattr(before, name)
        require(
            value is present or value == present,
            f"servo.{name}",
            value,
            "the same through a run: begin another run for that",
        )
    return after
