"""The loop, which moves the arm.

    plant.read() ─► servo.step() ─► plant.send()

on every tick of the plant's own clock.
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
    """Switch the drive on, servo to the target and yield every tick; to call it is a person's act.

    It begins from nothing, or goes on from the `state` of an earlier run, with what was learnt
    there. An `operator` is asked after every tick, and may request something, or change target and
    settings while the loop goes on. The run ends after `duration` s, when `done` says so, with a
    fault, and, where no `operator` stands by to resume, with a pause. However it ends, by itself,
    by an error or by Ctrl-C, the last thing it does is to bring the arm to rest and switch it off.
    """
    servo.demand(target)
    servo.warm_up()
    plant.reset()
    state = servo.init() if state is None else servo.again(state)
    agenda = NextTick(servo, target, operator)
    try:
        if state.phase is not Phase.FAULT:
            plant.enable()
        for time in ticks(plant.clock, servo.rate, duration):
            seen = plant.read()
            asked = agenda.request, agenda.jog
            state = agenda.servo.step(state, seen, agenda.target, *asked)
            applied = plant.send(state.command)
            tick = Tick(time, agenda.servo, seen, *asked, state, applied)
            yield tick
            if done(tick) or _over(state, operator):
                break
            agenda.steer(tick)
    finally:
        _rest(plant, agenda.servo, state.command)


def _over(state: State, operator: Operator | None) -> bool:
    """Whether nothing more will happen."""
    waits = (Phase.FAULT, Phase.PAUSED) if operator is None else ()
    return state.phase is Phase.DISABLED or (state.phase in waits and not state.command.rates.any())


def _rest(plant: Plant, servo: Servo, last: Command) -> None:
    """Ramp the joint rates to zero through the gate, from the next tick on, and switch the drive
    off.
    """
    try:
        plant.clock.wait_until(plant.clock.now() + servo.period)
        for _ in ticks(plant.clock, servo.rate):
            seen = plant.read()
            if not (last.enabled and last.rates.any() and seen.enabled):
                break
            last = servo.gate.admit(np.zeros(3), last, seen.q, servo.rcm, seen.now, 0.0).command
            plant.send(last)
    finally:
        plant.send(servo.gate.stop(last, plant.clock.now()))
