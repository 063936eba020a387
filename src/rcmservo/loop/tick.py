"""One round of the loop, as it is yielded, recorded and computed again."""

from dataclasses import dataclass

from rcmservo.interfaces import Floats, Observation
from rcmservo.safety.state_machine import Request
from rcmservo.servo.servo import Servo, State


@dataclass(frozen=True, eq=False)
class Tick:
    """One round of the loop, from what was seen to what the arm took of the command.

    Parameters
    ----------
    time : int
        ns since the loop's start.
    servo : Servo
        Which settings it went by.
    seen : Observation
        What the servo was told.
    request : Request
        What a person asked for.
    jog : Floats
        The joint rates (3,) asked for where that was to move them by hand, else zero.
    state : State
        What was decided, and towards which target.
    applied : Floats
        Joint rates (3,) that the arm took.
    """

    time: int
    servo: Servo
    seen: Observation
    request: Request
    jog: Floats
    state: State
    applied: Floats
