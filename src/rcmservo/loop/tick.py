"""Inputs and outputs of the servo at one tick of the loop."""

from dataclasses import dataclass

from rcmservo.interfaces import Floats, Observation
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo, State


@dataclass(frozen=True, eq=False)
class Tick:
    """One tick of the loop: the inputs of the servo, its state, and the applied joint rates.

    `servo_ticks` yields it. A recorder stores it, and a replay recomputes its state.

    Parameters
    ----------
    time : int
        Time at which the tick was due, in ns since the start of the loop.
    servo : Servo
        Settings at this tick.
    observation : Observation
        Joints, and markers of the newest frame.
    request : Request
        Request of the operator.
    jog : Floats
        Requested joint rates (3,) in rad/s, rad/s, mm/s if the request is JOG, else zero.
    state : State
        State of the servo after the tick, with command and target.
    applied : Floats
        Joint rates (3,) in rad/s, rad/s, mm/s that the arm applies of the command.
    """

    time: int
    servo: Servo
    observation: Observation
    request: Request
    jog: Floats
    state: State
    applied: Floats
