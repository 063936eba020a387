"""Scripted operator of a simulated run: resumes after a pause and teaches the target again."""

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import replace

from rcmservo.interfaces import Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.teach import TeachingFailed, teach
from rcmservo.safety.state_machine import Phase, Request
from rcmservo.servo.servo import Servo, State
from rcmservo.sim.rig import Rig

RESUME_DELAY_NS = 1_000_000_000
"""Time from a pause to the operator's request to resume, ns."""

TEACH_DELAY_NS = 3_000_000_000
"""Time from a pause until the operator teaches the target again, ns."""


class ScriptedOperator:
    """Operator that answers a limited number of pauses, each after a delay.

    It requests to resume or, if the cause of the pause requires it, teaches the target again.

    Parameters
    ----------
    rig : Rig
        Simulated laboratory in which the operator moves the tool.
    plant : Plant
        Plant that teaches the target.
    patience : int
        Number of pauses that the operator answers.
    frames : int
        Frames of each taught target.
    """

    resumed: int
    """Number of resume requests that the servo accepted."""

    refused: int
    """Number of resume requests that the servo refused."""

    taught: int
    """Number of times that the target was taught again."""

    def __init__(
        self, rig: Rig, plant: Plant, patience: int, frames: int = TEACHING_FRAMES
    ) -> None:
        self._rig, self._plant, self._pauses_left, self._frames = rig, plant, patience, frames
        self.resumed = self.refused = self.taught = 0
        self._since: int | None = None

    def __call__(self, tick: Tick) -> Request:
        """Return the request after a tick: to resume, once the pause has lasted long enough."""
        if not self._is_ready(tick) or tick.state.cause.needs_teaching:
            return Request.NONE
        self._since = None
        self._pauses_left -= 1
        return Request.RESUME

    def ends_run(self, tick: Tick) -> bool:
        """Return True if the operator ends the run, for good or to teach the target again.

        It also counts the outcome of a resume request, and must be called once per tick.
        """
        paused = tick.state.phase is Phase.PAUSED
        if tick.request is Request.RESUME:
            accepted = tick.state.phase is Phase.ACQUIRE
            self.resumed, self.refused = self.resumed + accepted, self.refused + (not accepted)
        self._since = (
            None if not paused else tick.observation.now if self._since is None else self._since
        )
        gives_up = paused and self._pauses_left <= 0 and not tick.state.command.rates.any()
        return (
            tick.state.phase is Phase.FAULT
            or gives_up
            or (self._is_ready(tick) and tick.state.cause.needs_teaching)
        )

    def teach_again(self, tick: Tick) -> Target | None:
        """Teach the target again, bring the tool back and return the new target.

        None if teaching does not help or fails.
        """
        state = tick.state
        if (
            state.phase is not Phase.PAUSED
            or not state.cause.needs_teaching
            or self._pauses_left <= 0
        ):
            return None
        self._since = None
        self._pauses_left -= 1
        joints = self._rig.arm.q_true
        self._rig.move_to_target()
        try:
            target = teach(self._plant, self._frames)
        except TeachingFailed:
            return None
        finally:
            self._rig.place(joints)
        self.taught += 1
        return target

    def _is_ready(self, tick: Tick) -> bool:
        """Return True if the pause has lasted long enough for the operator to answer it."""
        delay = TEACH_DELAY_NS if tick.state.cause.needs_teaching else RESUME_DELAY_NS
        return (
            self._pauses_left > 0
            and self._since is not None
            and tick.observation.now - self._since >= delay
        )


def run_attended(
    rig: Rig,
    plant: Plant,
    servo: Servo,
    target: Target,
    duration: float,
    operator: ScriptedOperator,
    begins: Callable[[Target, State | None], None] = lambda target, state: None,
) -> Generator[Tick]:
    """Run for `duration` s with a scripted operator, and yield its ticks.

    Time continues while the operator works.

    Parameters
    ----------
    rig : Rig
        Simulated laboratory.
    plant : Plant
        Plant of the rig's arm, camera and clock.
    servo : Servo
        Servo that runs.
    target : Target
        First target.
    duration : float
        Length of the whole run, s.
    operator : ScriptedOperator
        Operator that pauses, resumes and teaches.
    begins : callable
        Called at the start of every part of the run with its target and its initial state.
    """
    start = rig.clock.now()
    state: State | None = None
    while True:
        tick = None
        begins(target, state)
        offset = rig.clock.now() - start
        remaining = duration - offset * 1e-9
        with closing(
            run(plant, servo, target, remaining, operator.ends_run, state, operator)
        ) as ticks:
            for tick in ticks:
                yield replace(tick, time=tick.time + offset)
        new_target = None if tick is None else operator.teach_again(tick)
        if tick is None or new_target is None or rig.clock.now() - start >= duration * 1e9:
            return
        target, state = new_target, tick.state
