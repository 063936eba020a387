"""Scripted operator of a simulated run: answers pauses by resuming or by teaching the target again.

`run_attended` runs the servo with it.
"""

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import replace

from rcmservo.interfaces import Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import Tick, servo_ticks
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.loop.teach import TeachingFailed, teach
from rcmservo.safety.state_machine import Phase, Request
from rcmservo.servo.servo import Servo, State
from rcmservo.sim.rig import SimulatedRig

RESUME_DELAY_NS = 1_000_000_000
"""Time from a pause to the operator's request to resume, ns."""

TEACH_DELAY_NS = 3_000_000_000
"""Time from a pause until the operator teaches the target again, ns."""


class ScriptedOperator:
    """Operator that answers a limited number of pauses, each after a delay.

    It requests to resume or, if the cause of the pause requires that, teaches the target again.

    Parameters
    ----------
    rig : SimulatedRig
        Simulated laboratory in which the operator moves the tool.
    plant : Plant
        Plant with which the operator teaches the target.
    patience : int
        Number of pauses that the operator answers.
    frames : int
        Number of frames of each taught target.
    """

    resumed: int
    """Number of resume requests that the servo accepted."""

    refused: int
    """Number of resume requests that the servo refused."""

    taught: int
    """Number of times that the target was taught again."""

    def __init__(
        self, rig: SimulatedRig, plant: Plant, patience: int, frames: int = TEACHING_FRAMES
    ) -> None:
        self._rig, self._plant, self._pauses_left, self._frames = rig, plant, patience, frames
        self.resumed = self.refused = self.taught = 0
        self._pause_start: int | None = None

    def __call__(self, tick: Tick) -> Request:
        """Return the request after a tick: to resume, once the pause has lasted long enough."""
        if not self._is_ready(tick) or tick.state.cause.needs_teaching:
            return Request.NONE
        self._end_pause()
        return Request.RESUME

    def ends_run(self, tick: Tick) -> bool:
        """Return True if the operator ends the run, finally or to teach the target again.

        It also counts accepted and refused requests to resume; call it once per tick.
        """
        state = tick.state
        is_paused = state.phase is Phase.PAUSED
        if tick.request is Request.RESUME:
            is_accepted = state.phase is Phase.ACQUIRE
            self.resumed, self.refused = (
                self.resumed + is_accepted,
                self.refused + (not is_accepted),
            )
        if not is_paused:
            self._pause_start = None
        elif self._pause_start is None:
            self._pause_start = tick.observation.now
        gives_up = is_paused and self._pauses_left <= 0 and not state.command.rates.any()
        will_teach = self._is_ready(tick) and state.cause.needs_teaching
        return state.phase is Phase.FAULT or gives_up or will_teach

    def teach_again(self, tick: Tick) -> Target | None:
        """Teach the target again, bring the tool back and return the new target.

        Return None if the run did not end in a pause that requires teaching, or if teaching fails.
        """
        state = tick.state
        needs_teaching = state.phase is Phase.PAUSED and state.cause.needs_teaching
        if not needs_teaching or self._pauses_left <= 0:
            return None
        self._end_pause()
        joints = self._rig.truth.arm.q_true
        self._rig.move_to_target()
        try:
            target = teach(self._plant, self._frames)
        except TeachingFailed:
            return None
        finally:
            self._rig.place(joints)
        self.taught += 1
        return target

    def _end_pause(self) -> None:
        """Count a pause that the operator answers."""
        self._pause_start = None
        self._pauses_left -= 1

    def _is_ready(self, tick: Tick) -> bool:
        """Return True if the pause has lasted long enough for the operator to answer it."""
        if self._pauses_left <= 0 or self._pause_start is None:
            return False
        delay = TEACH_DELAY_NS if tick.state.cause.needs_teaching else RESUME_DELAY_NS
        return tick.observation.now - self._pause_start >= delay


def run_attended(
    rig: SimulatedRig,
    plant: Plant,
    servo: Servo,
    target: Target,
    duration: float,
    operator: ScriptedOperator,
    begins: Callable[[Target, State | None], None] = lambda target, state: None,
) -> Generator[Tick]:
    """Run for `duration` s with a scripted operator, and yield the ticks.

    Every time the operator teaches the target again, a new part of the run starts with the new
    target. Time continues while the operator works.

    Parameters
    ----------
    rig : SimulatedRig
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
        Operator that resumes and teaches.
    begins : callable
        Called at the start of every part of the run with its target and its initial state.

    Yields
    ------
    Tick
        Ticks, whose times count from the start of the whole run.
    """
    start = rig.clock.now()
    state: State | None = None
    while True:
        tick = None
        begins(target, state)
        elapsed = rig.clock.now() - start
        remaining_s = duration - elapsed * 1e-9
        ticks = servo_ticks(plant, servo, target, remaining_s, operator.ends_run, state, operator)
        with closing(ticks):
            for tick in ticks:
                yield replace(tick, time=tick.time + elapsed)
        new_target = None if tick is None else operator.teach_again(tick)
        if tick is None or new_target is None or rig.clock.now() - start >= duration * 1e9:
            return
        target, state = new_target, tick.state
