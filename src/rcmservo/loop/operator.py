"""Requests of an operator between two ticks, which change the inputs of the next tick.

No request enables the drive. A changed target or setting applies from the next tick on and begins a
new stage (a section with one servo and one target) in the record.
"""

from dataclasses import dataclass, field
from typing import Annotated, Protocol

import numpy as np

from rcmservo.constraints import Checked, array
from rcmservo.errors import BadInput
from rcmservo.interfaces import Command, Floats, Observation, Target
from rcmservo.loop.target_frames import FRAME_COUNT, TEACHING_FRAMES, TargetFrames
from rcmservo.loop.tick import Tick
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import ZERO_RATES, Servo

REST_TIME_NS = 200_000_000
"""Time in ns after which the tool counts as at rest, from the first command of zero rates."""

FIXED_PARTS = ("mechanism", "tool", "estimator", "imaged_rcm", "rate")
"""Settings of a servo that cannot change during a run, because the estimate depends on them."""


@dataclass(frozen=True)
class Teach(Checked):
    """Request of an operator to pause the run and teach the present pose as the target.

    The `Operator` that is passed to `run` submits it: it returns ``Teach()`` after one tick. The
    tool then stands still until enough frames show both markers, or until the next request. It
    stays paused, with the new target, until the operator returns ``Request.RESUME``.

    Parameters
    ----------
    frames : int
        Number of frames whose mean becomes the target, 1 to 100 000; 300 by default.

    Raises
    ------
    BadInput
        If the number of frames is out of range.

    Notes
    -----
    The frames agree if, for each coordinate of both markers, their noise is at most 2 px, and at
    most 5 % of them are outliers. The noise is 1.4826 times the median absolute deviation from the
    median, which is the standard deviation of Gaussian noise. An outlier deviates from the median
    by more than 6 times the noise, which counts as at least 0.7 px here.

    If the frames do not agree, they are discarded and as many are collected once more, without a
    limit of time; the earlier target stays until they agree. Before a run, `teach` does the same
    without an operator, but raises an error if the frames do not agree.
    """

    frames: Annotated[int, FRAME_COUNT] = TEACHING_FRAMES


@dataclass(frozen=True, eq=False)
class Jog(Checked, section="jog"):
    """Request to move the joints at given rates until the next tick.

    The `Operator` that is passed to `run` submits it: it returns ``Jog(rates)`` after every tick
    for as long as the joints shall move. Without the next request the arm comes to rest and the
    servo pauses. The phase must be IDLE, PAUSED or JOG; in another phase the request is ignored.

    Parameters
    ----------
    rates : Floats
        Joint rates (3,) in rad/s, rad/s, mm/s; finite numbers. The gate limits each to a fifth of
        the joint's speed limit.

    Raises
    ------
    BadInput
        If `rates` are not three finite numbers.
    """

    rates: Annotated[Floats, array(3)]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "rates", np.array(self.rates, dtype=np.float64))


OperatorRequest = Request | Target | Servo | Teach | Jog
"""Pause, resume or clear; another target; other settings; teaching; jogging."""


class Operator(Protocol):
    """Function that the loop calls after every tick for the request of the operator.

    Pass it to `run` as ``operator``. Any function of a `Tick` that returns a request satisfies this
    protocol; a class implements ``__call__``.

    Notes
    -----
    The call is part of the tick and must return within a millisecond. An exception ends the run:
    the loop brings the arm to rest, disables the drive and raises it to the caller of `run`.

    A `Servo` may differ from the present one in its `controller`, `exploration`, `gate` and
    `thresholds`. The estimate depends on the other settings, `mechanism`, `tool`, `estimator`,
    `imaged_rcm` and `rate`, which must be equal to the present ones.
    """

    def __call__(self, tick: Tick, /) -> OperatorRequest:
        """Return the request of the operator after a tick, without waiting.

        A `Request` pauses, resumes or clears, and ``Request.NONE`` requests nothing. A `Target`
        replaces the target. A `Servo` replaces the settings that may change during a run:
        `controller`, `exploration`, `gate` and `thresholds`. `Teach` teaches the present pose.
        `Jog` moves the joints until the next tick.

        Parameters
        ----------
        tick : Tick
            Tick that has just ended, with its observation, its request and the state after it.

        Returns
        -------
        Request, Target, Servo, Teach or Jog
            Request for the next tick.

        Raises
        ------
        BadInput
            The loop raises it for any other value, and for ``Request.JOG``, whose rates only a
            `Jog` has. It raises it for a servo whose `mechanism`, `tool`, `estimator`, `imaged_rcm`
            or `rate` differs from the present one. It also raises it if the features of the
            controller need the markers' radii (those of 'size', or any with ``needs_sizes``) and
            the target has none.
        """
        ...


@dataclass
class TeachingInRun:
    """Teaching of a target during a run.

    Parameters
    ----------
    frames : int
        Number of frames requested.
    stopped_ns : int or None
        Time of the first command of zero rates, ns; None while the tool moves.
    target_frames : TargetFrames
        Frames so far.
    newest_frame : int
        Number of the newest frame examined.
    """

    frames: int
    stopped_ns: int | None = None
    target_frames: TargetFrames = field(default_factory=TargetFrames)
    newest_frame: int = -1

    def add(self, observation: Observation, command: Command) -> Target | None:
        """Add the frame of a tick; return the target once enough frames agree."""
        if command.rates.any():
            self.stopped_ns = None
        elif self.stopped_ns is None:
            self.stopped_ns = observation.now
        if self.stopped_ns is None or observation.frame == self.newest_frame:
            return None
        self.newest_frame = observation.frame
        is_at_rest = observation.exposure >= self.stopped_ns + REST_TIME_NS
        if is_at_rest and np.isfinite(observation.points).all():
            self.target_frames.add(observation)
        if len(self.target_frames.points) < self.frames:
            return None
        if self.target_frames.describe_disagreement():
            self.target_frames = TargetFrames()
            return None
        return self.target_frames.compute_target(self.stopped_ns)


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
        self.servo, self.target, self.request, self.jog = servo, target, Request.NONE, ZERO_RATES
        self._operator = operator
        self._teaching: TeachingInRun | None = None

    def ask_operator(self, tick: Tick) -> None:
        """Call the operator after a tick and prepare the next tick."""
        self.request, self.jog = Request.NONE, ZERO_RATES
        if self._operator is None:
            return
        request = self._operator(tick)
        if request is not Request.NONE:
            self._teaching = None
            self._apply_request(request)
        if self._teaching is not None:
            target = self._teaching.add(tick.observation, tick.state.command)
            if target is not None:
                self._teaching = None
                self._set_target(target)

    def _apply_request(self, request: OperatorRequest) -> None:
        match request:
            case Request.JOG:
                raise BadInput("operator()", request, "a Jog, with the joint rates")
            case Request():
                self.request = request
            case Jog():
                self.request, self.jog = Request.JOG, request.rates
            case Target():
                self._set_target(request)
            case Servo():
                changed = check_changed_servo(self.servo, request)
                changed.require_target(self.target)
                self.servo = changed
            case Teach():
                self.request, self._teaching = Request.PAUSE, TeachingInRun(request.frames)
            case _:
                raise BadInput("operator()", request, "a Request, Target, Servo, Teach or Jog")

    def _set_target(self, target: Target) -> None:
        """Replace the target, unless the numbers of both are the same."""
        if target != self.target:
            self.servo.require_target(target)
            self.target = target


def check_changed_servo(before: Servo, after: Servo) -> Servo:
    """Return a servo with changed settings if the present estimate remains valid for it.

    Raises
    ------
    BadInput
        If a part differs that cannot change during a run, or if the feature vector of one servo is
        compiled and that of the other is not: their estimators then store different numbers.
    """
    for name in FIXED_PARTS:
        present_part, new_part = getattr(before, name), getattr(after, name)
        if new_part is not present_part and new_part != present_part:
            expected = "the same during a run: start another run to change it"
            raise BadInput(f"servo.{name}", new_part, expected)
    if (before.kernel is None) != (after.kernel is None):
        present, new = before.controller.features, after.controller.features
        expected = f"{present} or another that {'Python' if before.kernel is None else 'a kernel'} "
        expected += "computes: start another run to change it"
        raise BadInput("servo.controller.features", new, expected)
    return after
