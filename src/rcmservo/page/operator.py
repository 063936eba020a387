"""The person at the page, as the loop asks for one after every tick.

the session begins       paused: nothing moves before the person says where to
no sign of life          what moves by itself is paused
a jog button is held     the joints move, as long as the page says so anew
a tour                   the tool goes from pose to pose, until something stops it
"""

from collections import deque
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import joint_rates
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.operator import Jog, OperatorRequest, Teach, changed_servo
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.tick import Tick
from rcmservo.page.channels import Desk
from rcmservo.page.jog_state import NONE, Gesture
from rcmservo.page.messages import Aim, Change, Go, InForce, Note, OnTour, Taught, TeachAs, Teaching
from rcmservo.page.settings import AT_ONCE, Chosen
from rcmservo.page.pose_sequence import BY_ITSELF, GoOnTour, HowFar, Touring
from rcmservo.safety.state_machine import SLOW_SHARE, Phase, Request
from rcmservo.servo.servo import Servo

GONE = 500_000_000
"""ns without a sign of life from the person in control after which the tool is paused."""

LET_GO = 80_000_000
"""ns after which a jog button that nobody says is held counts as let go."""

EVERY = 15
"""Frames between two sentences on how far teaching is, a quarter of a second."""

Wanted = TypeVar("Wanted", Target, Servo)


class PageOperator:
    """What the page wants, from tick to tick. ``chosen`` is what was set as the session began, and
    a target is the mean of so many ``frames``.
    """

    def __init__(self, desk: Desk, chosen: Chosen, frames: int = TEACHING_FRAMES) -> None:
        self._desk, self._chosen, self._frames = desk, chosen, frames
        self._servo: Servo | None = None
        self._wants: deque[tuple[OperatorRequest, str | None]] = deque([(Request.PAUSE, None)])
        gesture = desk.hand.read() or Gesture()
        self._gesture, self._spent = gesture, gesture.press
        self._beat: int | None = None
        self._asked = NONE
        self._teaching: str | None = None
        self._observed, self._frame = 0, -1
        self._target: Target | None = None
        self._touring: Touring | None = None
        self._progress: HowFar | None = None
        joint_rates(chosen.servo.rcm, np.zeros(3), np.zeros(3))  # compiled before the loop begins

    def __call__(self, tick: Tick) -> OperatorRequest:
        self._desk.ticks.add(tick)
        self._tell(tick)
        self._tell_teaching(tick)
        self._look(tick)
        self._tours(tick)
        for told in self._desk.wants.heard():
            self._hear(told, tick)
        if self._alone(tick):
            self._wants.clear()
            return Request.PAUSE
        if not self._wants:
            return self._jog(tick)
        want, name = self._wants.popleft()
        self._teaches_no_more()
        self._teaching = name
        return want

    def _teaches_no_more(self) -> None:
        """Tell of what was to be taught and was not."""
        if self._teaching is not None:
            self._desk.said.put(Note(f"{self._teaching or 'the target'} was not taught"))
            self._end_teaching()

    def _end_teaching(self) -> None:
        self._teaching = None
        self._observed = 0
        self._desk.said.put(Teaching(""))

    def _tell_teaching(self, tick: Tick) -> None:
        """Tell how many frames have shown both markers since teaching began."""
        new = tick.seen.frame != self._frame and bool(np.isfinite(tick.seen.points).all())
        self._frame = tick.seen.frame
        if self._teaching is None or not new:
            return
        self._observed += 1
        if self._observed % EVERY == 1:
            count = f"{self._observed} frames so far, {self._frames} are needed"
            self._desk.said.put(Teaching(f"teaching, keep the tool still: {count}"))

    def _look(self, tick: Tick) -> None:
        """See what the hand does. A press is over that was not renewed in time."""
        now, gesture = tick.seen.now, self._desk.hand.read() or self._gesture
        if self._beat is None or gesture.life != self._gesture.life:
            self._beat = now
        elif now - self._beat > LET_GO:
            self._spent = gesture.press
        self._gesture = gesture

    def _hear(self, told: object, tick: Tick) -> None:
        match told:
            case Go():
                self._go(told.target, (told.target,), tick)
            case GoOnTour():
                if self._go(told.targets[0], told.targets, tick):
                    self._touring = Touring(told)
            case TeachAs():
                self._wants.append((Teach(self._frames), told.name))
            case Change():
                self._set(told, tick)
            case Request():
                self._wants.append((told, None))
            case _:
                self._desk.said.put(Note(f"{type(told).__name__}: not while the drive is on"))

    def _go(self, target: Target, all_of: tuple[Target, ...], tick: Tick) -> bool:
        """Go to a target, if the settings can go to all of them; whether they can."""
        try:
            for one in all_of:
                self._next(Servo, tick.servo).demand(one)
        except BadInput as error:
            self._desk.said.put(Note(str(error)))
            return False
        self._wants.append((target, None))
        if tick.state.phase not in BY_ITSELF:
            self._wants.append((Request.RESUME, None))
        return True

    def _tours(self, tick: Tick) -> None:
        """Go on with a tour, once the tick goes by all that was wanted."""
        touring = self._touring
        if touring is not None and not self._wants:
            if touring.look(tick):
                self._wants.append((touring.target, None))
            elif touring.progress is None:
                self._touring = None
                if tick.state.phase in BY_ITSELF:
                    self._wants.append((Request.PAUSE, None))
                self._desk.said.put(Note(touring.words))
        progress = None if self._touring is None else self._touring.progress
        if progress != self._progress:
            self._progress = progress
            self._desk.said.put(OnTour(progress))

    def _set(self, change: Change, tick: Tick) -> None:
        """Have a box changed that may be now; the others are the next session's."""
        if change.box not in AT_ONCE:
            return
        try:
            chosen = self._chosen.with_change(change)
            servo = changed_servo(tick.servo, chosen.limited)
            assert tick.state.target is not None
            servo.demand(self._next(Target, tick.state.target))
        except BadInput as error:
            self._desk.said.put(Note(f"not before the next session: {error}"))
            return
        self._chosen = chosen
        self._wants.append((servo, None))

    def _next(self, kind: type[Wanted], now: Wanted) -> Wanted:
        """What the loop will go by once it has what waits to be wanted; `now` is what it has."""
        return next((one for one, _ in reversed(self._wants) if isinstance(one, kind)), now)

    def _alone(self, tick: Tick) -> bool:
        """Whether the tool goes its own way while nobody is there."""
        assert self._beat is not None
        return tick.state.phase in BY_ITSELF and tick.seen.now - self._beat > GONE

    def _jog(self, tick: Tick) -> OperatorRequest:
        """The motion of a button that is held. A press that something else ended is over too."""
        gesture = self._gesture
        if self._asked != NONE and tick.state.phase is not Phase.JOG:
            self._spent = self._asked
        going = gesture.press not in (NONE, self._spent)
        self._asked = gesture.press if going else NONE
        if not going:
            return Request.NONE
        self._teaches_no_more()
        if self._touring is not None:
            return Request.PAUSE
        rates = _rates(gesture, tick)
        return Jog(rates) if np.isfinite(rates).all() else Request.NONE

    def _tell(self, tick: Tick) -> None:
        """Tell the page of settings and a target that are new, and of one that was taught."""
        if tick.servo is not self._servo:
            self._servo = tick.servo
            self._desk.said.put(InForce(replace(tick.servo)))
        target = tick.state.target
        if target is None or target is self._target:
            return
        self._target = target
        self._desk.said.put(Aim(target))
        if self._teaching is not None:
            shown = Note("the target is shown again")
            self._desk.said.put(Taught(self._teaching, target) if self._teaching else shown)
            self._end_teaching()


def _rates(gesture: Gesture, tick: Tick) -> Floats:
    """The joint rates (3,) that a gesture means where the joints are now, at its share of the jog's
    speed at most. They are not finite where the joints are not known.
    """
    rates = np.array([gesture.a, gesture.b, gesture.c])
    if gesture.leads:
        rates = joint_rates(tick.servo.rcm, np.array(tick.seen.q), rates)
    fastest = SLOW_SHARE * gesture.share * np.array(tick.servo.gate.speed)
    return rates / max(1.0, float(np.abs(rates / fastest).max()))
