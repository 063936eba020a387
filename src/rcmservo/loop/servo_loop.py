"""Loop that moves the arm.

At each tick of the plant's clock it reads an observation, makes one step of the servo and sends the
command to the arm:

    plant.read() ─► servo.step() ─► plant.send()
"""

from collections.abc import Callable, Generator

import numpy as np

from rcmservo.interfaces import Command, Target
from rcmservo.loop.clock import DURATION, ticks
from rcmservo.loop.operator import NextTick, Operator
from rcmservo.loop.plant import Plant
from rcmservo.loop.tick import Tick
from rcmservo.safety.state_machine import Phase
from rcmservo.safety.target_checks import require_markers_in_image
from rcmservo.servo.servo import Servo, State


def servo_ticks(
    plant: Plant,
    servo: Servo,
    target: Target,
    duration: float = 30.0,
    until: Callable[[Tick], bool] = lambda tick: False,
    state: State | None = None,
    operator: Operator | None = None,
) -> Generator[Tick]:
    """Enable the drive, move the tool to a target and yield every tick.

    Call it only as a consequence of a user's action, because the arm moves. The run ends after
    `duration`, when `until` returns True, or with a fault. Without an `operator`, who could resume,
    a pause ends it too. At the end, even after an error or Ctrl-C, the loop brings the arm to rest
    and disables the drive. Close the generator, or exhaust it, so that this happens at once.
    Nothing moves and nothing is checked before the first tick is requested from the generator.

    Parameters
    ----------
    plant : Plant
        Arm, camera, tracker and clock.
    servo : Servo
        Settings at the start; ``servo.rate`` is the number of ticks per second.
    target : Target
        Target at the start, from `teach` or a target file.
    duration : float
        Longest duration in s, positive; 30 by default.
    until : Callable
        Function of a `Tick` that returns True to end the run; by default it never does.
    state : State or None
        Last state of an earlier run, whose estimate is used; None starts without an estimate.
    operator : Operator or None
        Function of a `Tick` that the loop calls after every tick. It returns a `Request`, another
        `Target` or `Servo`, a `Teach` or a `Jog`, and must not wait. A `Servo` may differ in its
        `controller`, `exploration`, `gate` and `thresholds`; its other settings must stay.

    Yields
    ------
    Tick
        Inputs, state and applied joint rates of each tick.

    Raises
    ------
    BadInput
        Before the drive is enabled: if `duration` is not positive, if the target is invalid, as
        `Servo.require_target` describes, or outside the newest image, or if a feature vector fails
        or its Jacobian is not its derivative. Later: if a device returns a value of an
        invalid type or shape, or if a request of the operator is invalid, as `Operator` describes.
    UnusableEstimator
        If a user-defined estimator fails or is not pure, before the drive is enabled; the class is
        in `rcmservo.servo.user_estimator`.
    NotEnabled
        If the arm does not report its drive as on within 2 s; the class is in
        `rcmservo.loop.plant`.
    Exception
        An exception of a device, of `operator` or of `until` ends the run and reaches the caller
        after the arm is brought to rest and the drive disabled. A `BadInput` of ``Tracker.find``
        only drops the frame. In motion, a failure of a user-defined estimator or feature vector is
        a fault, which ends a run without an operator and raises nothing.
    """
    DURATION.require("duration", duration)
    servo.require_target(target)
    _require_in_image(target, plant.image_shape)
    servo.warm_up()
    plant.reset()
    state = servo.init() if state is None else servo.restart(state)
    next_tick = NextTick(servo, target, operator)
    try:
        if state.phase is not Phase.FAULT:
            plant.enable()
        for time in ticks(plant.clock, servo.rate, duration):
            observation = plant.read()
            request, jog = next_tick.request, next_tick.jog
            state = next_tick.servo.step(state, observation, next_tick.target, request, jog)
            applied = plant.send(state.command)
            tick = Tick(time, next_tick.servo, observation, request, jog, state, applied)
            yield tick
            if until(tick) or _is_over(state, operator):
                break
            next_tick.ask_operator(tick)
    finally:
        _bring_to_rest(plant, next_tick.servo, state.command)


def _require_in_image(target: Target, image_shape: tuple[int, ...] | None) -> None:
    """Raise `BadInput` for a target outside the images of the camera, if one has been seen."""
    if image_shape is not None:
        height, width = image_shape[:2]
        require_markers_in_image("target.points", target.points, width, height)


def _is_over(state: State, operator: Operator | None) -> bool:
    """Return True if the drive is off, or the arm is at rest and no operator can resume."""
    final_phases = () if operator is not None else (Phase.FAULT, Phase.PAUSED)
    is_at_rest = not state.command.rates.any()
    return state.phase is Phase.DISABLED or (state.phase in final_phases and is_at_rest)


def _bring_to_rest(plant: Plant, servo: Servo, last: Command) -> None:
    """Ramp the joint rates from those of the `last` command to zero, then disable the drive.

    The gate bounds the decelerations.
    """
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
