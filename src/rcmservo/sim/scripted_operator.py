"""A scripted person beside a simulated run: resumes after a pause, shows the target again."""

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import replace

from rcmservo.guard.states import Phase, Request
from rcmservo.interfaces import Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.shown import TEACHING_FRAMES
from rcmservo.loop.teach import NotShown, teach
from rcmservo.servo.servo import Servo, State
from rcmservo.sim.rig import Rig

THINKS = 1_000_000_000
"""ns that the person takes before resuming."""

LOOKS = 3_000_000_000
"""ns that the person takes before showing the target again."""


class ScriptedPerson:
    """Acts after a pause, at most ``patience`` times: asks to resume, or shows the target again,
    for so many frames."""

    resumed: int
    """How often the servo went on when asked."""

    refused: int
    """How often it did not."""

    shown: int
    """How often the target was shown again."""

    def __init__(
        self, rig: Rig, plant: Plant, patience: int, frames: int = TEACHING_FRAMES
    ) -> None:
        self._rig, self._plant, self._left, self._frames = rig, plant, patience, frames
        self.resumed = self.refused = self.shown = 0
        self._since: int | None = None

    def __call__(self, tick: Tick) -> Request:
        """What the person asks for after a tick: to go on, once the tool was paused for a while."""
        if not self._acts(tick) or tick.state.cause.needs_teaching:
            return Request.NONE
        self._since = None
        self._left -= 1
        return Request.RESUME

    def leaves(self, tick: Tick) -> bool:
        """Whether the person ends the run: for good, or to show the target again."""
        paused = tick.state.phase is Phase.PAUSED
        if tick.request is Request.RESUME:
            went_on = tick.state.phase is Phase.ACQUIRE
            self.resumed, self.refused = self.resumed + went_on, self.refused + (not went_on)
        self._since = None if not paused else tick.seen.now if self._since is None else self._since
        over = paused and self._left <= 0 and not tick.state.command.rates.any()
        return (
            tick.state.phase is Phase.FAULT
            or over
            or (self._acts(tick) and tick.state.cause.needs_teaching)
        )

    def shows_again(self, tick: Tick) -> Target | None:
        """The target, shown once more. The tool is brought back to where it stood.

        None where showing it is of no use.
        """
        state = tick.state
        if state.phase is not Phase.PAUSED or not state.cause.needs_teaching or self._left <= 0:
            return None
        self._since = None
        self._left -= 1
        stood = self._rig.arm.q_true
        self._rig.show_target()
        try:
            target = teach(self._plant, self._frames)
        except NotShown:
            return None
        finally:
            self._rig.place(stood)
        self.shown += 1
        return target

    def _acts(self, tick: Tick) -> bool:
        wait = LOOKS if tick.state.cause.needs_teaching else THINKS
        return self._left > 0 and self._since is not None and tick.seen.now - self._since >= wait


def attended(
    rig: Rig,
    plant: Plant,
    servo: Servo,
    target: Target,
    duration: float,
    person: ScriptedPerson,
    begins: Callable[[Target, State | None], None] = lambda target, state: None,
) -> Generator[Tick]:
    """`run` with a person beside it, for `duration` s in all.

    Time goes on while the person is at work.

    ``begins`` is told of every new run: its target, and the state that it goes on from.
    """
    start = rig.clock.now()
    state: State | None = None
    while True:
        tick = None
        begins(target, state)
        offset = rig.clock.now() - start
        left = duration - offset * 1e-9
        with closing(run(plant, servo, target, left, person.leaves, state, person)) as ticks:
            for tick in ticks:
                yield replace(tick, time=tick.time + offset)
        again = None if tick is None else person.shows_again(tick)
        if tick is None or again is None or rig.clock.now() - start >= duration * 1e9:
            return
        target, state = again, tick.state
