"""Reduced speed for a lab whose rig file has not passed `rcmservo rig check`.

One factor scales all limits of the speed: those of the gate, which no command exceeds, and that of
the control law. Exploration moves along shorter paths at the lower speeds of the gate, so its time
limit grows by the same factor. Accelerations are not changed.
"""

from dataclasses import replace

from rcmservo.servo.servo import Servo

UNCHECKED_SPEED_SCALE = 0.1
"""Fraction of the full speed for an unchecked lab."""


def reduce_speed(servo: Servo, speed_scale: float = UNCHECKED_SPEED_SCALE) -> Servo:
    """Return a servo with a fraction of another servo's speed limits.

    Parameters
    ----------
    servo : Servo
        Servo with the full speed limits.
    speed_scale : float
        Fraction of the full speed, above 0 and at most 1.
    """
    x, y, z = servo.gate.speed
    law, exploration = servo.controller, servo.exploration
    return replace(
        servo,
        gate=replace(servo.gate, speed=(speed_scale * x, speed_scale * y, speed_scale * z)),
        controller=replace(law, max_speed=speed_scale * law.max_speed),
        exploration=replace(exploration, max_time=exploration.max_time / speed_scale),
    )
