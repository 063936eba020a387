"""Record of one tick of the loop."""

from dataclasses import dataclass

from rcmservo.interfaces import Floats, Observation
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo, State


@dataclass(frozen=True, eq=False)
class Tick:
    """One tick of the loop: inputs, state and applied joint rates.

    `run` yields it. A recorder stores it, and a replay computes it once more.

    Parameters
    ----------
    time : int
        Time since the start of the loop, ns.
    servo : Servo
        Settings at this tick.
    observation : Observation
        Observation, the input of the servo.
    request : Request
        Request of the operator.
    jog : Floats
        Requested joint rates (3,) in rad/s, rad/s, mm/s if the request is JOG, else zero.
    state : State
        State after the tick, with command and target.
    applied : Floats
        Joint rates (3,) in rad/s, rad/s, mm/s that the arm applies.
    """

    time: int
    servo: Servo
    observation: Observation
    request: Request
    jog: Floats
    state: State
    applied: Floats
