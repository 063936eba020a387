"""The person beside the loop: what may be wanted between two ticks, and what the next tick then
goes by.

Nothing of it restarts the drive. A changed target or setting holds from the next tick on, and
begins a new stage in the record.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, array
from rcmservo.errors import require
from rcmservo.guard.states import Request
from rcmservo.interfaces import Command, Floats, Observation, Target
from rcmservo.loop.shown import FRAMES, TEACHING_FRAMES, TargetFrames
from rcmservo.loop.tick import Tick
from rcmservo.servo.servo import Servo

SETTLE = 200_000_000
"""ns after the first command to stand still from which on a frame shows a tool that does."""

FIXED = ("mechanism", "tool", "estimator", "imaged_rcm", "rate")
"""What a servo keeps through a run: what was learnt belongs to these."""


@dataclass(frozen=True)
class Teach(Checked):
    """Wanted: the tool pauses, and what the camera then sees becomes the target.

    The tool stands still until enough frames have shown both markers, or until the person wants
    something else. Then it stays paused until the person resumes.
    """

    frames: Annotated[int, FRAMES] = TEACHING_FRAMES
    """Frames to take the mean of."""


STILL = np.zeros(3)


@dataclass(frozen=True, eq=False)
class Jog(Checked, section="jog"):
    """Wanted: that the joints go at these rates until the next tick, each at a fifth of its bound
    at most, from IDLE or PAUSED.

    It must be wanted again after every tick. Once it is not, the arm comes to rest and the servo is
    paused.
    """

    rates: Annotated[Floats, array(3)]
    """Joint rates (3,) rad/s, rad/s, mm/s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "rates", np.array(self.rates, dtype=np.float64))


Want = Request | Target | Servo | Teach | Jog
"""What a person may want between two ticks: to pause, resume or clear; another target; other
settings; that the target be taught now; or to move the joints by hand."""

Operator = Callable[[Tick], Want]
"""A person beside the loop. It is called after every tick and must answer at once."""


@dataclass
class Showing:
    """The frames of a target that is being taught in mid-run."""

    frames: int
    """How many are wanted."""
    since: int | None = None
    """When the tool was told to stand still, ns; None while it moves."""
    shown: TargetFrames = field(default_factory=TargetFrames)
    """Those so far."""
    last: int = -1
    """Number of the newest frame looked at."""

    def add(self, seen: Observation, command: Command) -> Target | None:
        """Take what a tick has seen; the target once there are enough frames that agree on it."""
        if command.rates.any():
            self.since = None
        elif self.since is None:
            self.since = seen.now
        if self.since is None or seen.frame == self.last:
            return None
        self.last = seen.frame
        if seen.exposure >= self.since + SETTLE and np.isfinite(seen.points).all():
            self.shown.add(seen)
        if len(self.shown.points) < self.frames:
            return None
        if self.shown.why_not():
            self.shown = TargetFrames()
            return None
        return self.shown.target(self.since)


class Agenda:
    """What the loop goes by: a ``servo``, a ``target``, and what a person asks for (``request``,
    and the joint rates ``jog`` of one who moves the arm by hand).

    An ``operator`` may change it between two ticks.
    """

    def __init__(self, servo: Servo, target: Target, operator: Operator | None) -> None:
        self.servo, self.target, self.request, self.jog = servo, target, Request.NONE, STILL
        self._operator = operator
        self._showing: Showing | None = None

    def steer(self, tick: Tick) -> None:
        """Ask the operator after a tick, and set what the next one goes by."""
        self.request, self.jog = Request.NONE, STILL
        if self._operator is None:
            return
        want = self._operator(tick)
        if want is not Request.NONE:
            self._showing = None
            self._set(want)
        if self._showing is not None:
            self._show(self._showing, tick)

    def _set(self, want: Want) -> None:
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
                self.servo = goes_on(self.servo, want)
            case Teach():
                self.request, self._showing = Request.PAUSE, Showing(want.frames)
            case _:
                require(False, "operator()", want, "a Request, Target, Servo, Teach or Jog")

    def _show(self, showing: Showing, tick: Tick) -> None:
        target = showing.add(tick.seen, tick.state.command)
        if target is not None:
            self._showing = None
            self._aim(target)

    def _aim(self, target: Target) -> None:
        """Aim at another target; at the same numbers it aims already."""
        if not same(target, self.target):
            self.servo.demand(target)
            self.target = target


def same(one: Target, other: Target) -> bool:
    """Whether two targets are the same, down to the bits."""
    return (
        one.points.tobytes() == other.points.tobytes()
        and one.q.tobytes() == other.q.tobytes()
        and one.shown == other.shown
        and np.array_equal(one.sizes, other.sizes, equal_nan=True)
    )


def goes_on(before: Servo, after: Servo) -> Servo:
    """The servo with other settings, where what was learnt stays of use; BadInput where not."""
    for name in FIXED:
        value = getattr(after, name)
        kept = getattr(before, name)
        require(
            value is kept or value == kept,
            f"servo.{name}",
            value,
            "the same through a run: begin another run for that",
        )
    return after
