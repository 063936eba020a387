"""Loop that moves the arm.

At each tick of the plant's clock it reads an observation, makes one step of the servo and sends the
command:

    plant.read() ─► servo.step() ─► plant.send()
"""

from collections.abc import Callable, Generator

import numpy as np

from rcmservo.interfaces import Command, Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.operator import NextTick, Operator
from rcmservo.loop.plant import Plant
from rcmservo.loop.tick import Tick
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo, State


def run(
    plant: Plant,
    servo: Servo,
    target: Target,
    duration: float = 30.0,
    done: Callable[[Tick], bool] = lambda tick: False,
    state: State | None = None,
    operator: Operator | None = None,
) -> Generator[Tick]:
    """Enable the drive, servo to a target and yield every tick. A user's action causes the call.

    The run ends after `duration`, when `done` returns True, or with a fault; without an `operator`,
    who could resume, also with a pause. Whatever ends it, even an error or Ctrl-C, the loop at last
    brings the arm to rest and disables the drive.

    Parameters
    ----------
    plant : Plant
        Arm, camera, tracker and clock.
    servo : Servo
        Settings at the start.
    target : Target
        Target at the start.
    duration : float
        Longest duration in s.
    done : Callable
        Condition on a tick that ends the run.
    state : State or None
        Last state of an earlier run, whose estimate is used; None starts without an estimate.
    operator : Operator or None
        Function that the loop calls after every tick for a request, another target or settings.

    Yields
    ------
    Tick
        Inputs, state and applied joint rates of each tick.

    Raises
    ------
    BadInput
        If target, feature vector or device does not fit, or if a request is invalid.
    UnusableEstimator
        If a user-defined estimator fails before the drive is enabled.
    NotEnabled
        If the drive does not come on.
    """
    servo.require_target(target)
    servo.warm_up()
    plant.reset()
    state = servo.init() if state is None else servo.restart(state)
    inputs = NextTick(servo, target, operator)
    try:
        if state.phase is not Phase.FAULT:
            plant.enable()
        for time in ticks(plant.clock, servo.rate, duration):
            observation = plant.read()
            request, jog = inputs.request, inputs.jog
            state = inputs.servo.step(state, observation, inputs.target, request, jog)
            applied = plant.send(state.command)
            tick = Tick(time, inputs.servo, observation, request, jog, state, applied)
            yield tick
            if done(tick) or _is_over(state, operator):
                break
            inputs.ask_operator(tick)
    finally:
        _bring_to_rest(plant, inputs.servo, state.command)


def _is_over(state: State, operator: Operator | None) -> bool:
    """Return True if nothing more can happen: drive off, or at rest with no one to resume."""
    final = (Phase.FAULT, Phase.PAUSED) if operator is None else ()
    return state.phase is Phase.DISABLED or (state.phase in final and not state.command.rates.any())


def _bring_to_rest(plant: Plant, servo: Servo, last: Command) -> None:
    """Ramp the joint rates to zero through the gate from the next tick on; disable the drive."""
    try:
        plant.clock.wait_until(plant.clock.now() + servo.period)
        for _ in ticks(plant.clock, servo.rate):
            observation = plant.read()
            now, q = observation.now, observation.q
            if not (last.enabled and last.rates.any() and observation.enabled):
                break
            last = servo.gate.admit(np.zeros(3), last, q, servo.rcm, now, 0.0).command
            plant.send(last)
    finally:
        plant.send(servo.gate.stop(last, plant.clock.now()))
