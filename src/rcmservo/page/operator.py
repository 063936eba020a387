"""The person at the page, as the loop asks for one after every tick.

the session begins       paused: nothing moves before the person says where to
nobody beats any more    what moves by itself is paused
a jog button is held     the joints move, as long as the page says so anew
"""

from collections import deque

import numpy as np

from rcmservo.errors import BadInput
from rcmservo.guard.states import Phase, Request
from rcmservo.interfaces import Target
from rcmservo.loop.operator import Jog, Teach, Want
from rcmservo.loop.tick import Tick
from rcmservo.page.desk import Desk
from rcmservo.page.wants import Aim, Beat, Go, Held, Note, Taught, TeachAs

GONE = 500_000_000
"""ns without a word from the person in control after which the tool is paused."""

LET_GO = 80_000_000
"""ns after which a jog button that nobody says is held counts as let go."""

BY_ITSELF = Phase.ACQUIRE, Phase.SERVO, Phase.HOLD
"""Phases in which the tool goes its own way."""


class PageOperator:
    """What the page wants, from tick to tick."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._wants: deque[Want] = deque([Request.PAUSE])
        self._beat: int | None = None
        self._held: tuple[Held, int] | None = None
        self._asked: Held | None = None
        self._spent = -1
        self._teaching = ""
        self._target: Target | None = None

    def __call__(self, tick: Tick) -> Want:
        self._desk.ticks.put(tick)
        self._tell(tick)
        self._hear(tick)
        if self._alone(tick):
            self._wants.clear()
            return Request.PAUSE
        if self._wants:
            return self._wants.popleft()
        return self._jog(tick)

    def _hear(self, tick: Tick) -> None:
        """Take what the page has said since the last tick."""
        now = tick.seen.now
        self._beat = now if self._beat is None else self._beat
        for told in self._desk.wants.heard():
            if isinstance(told, Held):
                self._held = told, now
            if isinstance(told, Held | Beat):
                self._beat = now
                continue
            try:
                self._want(told, tick)
            except BadInput as error:
                self._desk.said.put(Note(str(error)))

    def _want(self, told: object, tick: Tick) -> None:
        match told:
            case Go():
                tick.servo.demand(told.target)
                going = tick.state.phase in BY_ITSELF
                self._teaching = ""
                self._wants.extend([told.target] if going else [told.target, Request.RESUME])
            case TeachAs():
                self._teaching = told.name
                self._wants.append(Teach())
            case Request():
                self._wants.append(told)
            case _:
                self._desk.said.put(Note(f"{type(told).__name__}: not while the drive is on"))

    def _alone(self, tick: Tick) -> bool:
        """Whether the tool goes its own way while nobody is there."""
        assert self._beat is not None
        return tick.state.phase in BY_ITSELF and tick.seen.now - self._beat > GONE

    def _jog(self, tick: Tick) -> Want:
        """The motion of a button that is held. A press that was ended otherwise than by the person
        is over."""
        asked, self._asked = self._asked, None
        if asked is not None and tick.state.phase is not Phase.JOG:
            self._spent = asked.press
        if self._held is None:
            return Request.NONE
        held, since = self._held
        if tick.seen.now - since > LET_GO or held.press == self._spent:
            self._held = None
            return Request.NONE
        self._asked = held
        return Jog(np.array(held.rates))

    def _tell(self, tick: Tick) -> None:
        """Tell the page of a target that is new, and of one that was taught."""
        target = tick.state.target
        if target is None or target is self._target:
            return
        self._target = target
        self._desk.said.put(Aim(target))
        if self._teaching:
            self._desk.said.put(Taught(self._teaching, target))
            self._teaching = ""
