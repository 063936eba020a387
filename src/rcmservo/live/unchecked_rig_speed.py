"""Reduced speed for an arm and camera whose rig file has not passed `rcmservo rig check`.

One factor scales all limits of the speed: those of the gate, which no command exceeds, and that of
the controller. Exploration takes longer at the lower speeds, so its time limit is divided by the
same factor. Accelerations are not changed.
"""

from dataclasses import replace

from rcmservo.servo.servo import Servo

UNCHECKED_SPEED_SCALE = 0.1
"""Fraction of the full speed for an unchecked arm and camera."""


def reduce_speed(servo: Servo, speed_scale: float = UNCHECKED_SPEED_SCALE) -> Servo:
    """Return a servo with a fraction of another servo's speed limits.

    Parameters
    ----------
    servo : Servo
        Servo with the full speed limits.
    speed_scale : float
        Fraction of the full speed, above 0 and at most 1.
    """
    joint_1, joint_2, joint_3 = servo.gate.speed
    max_rates = speed_scale * joint_1, speed_scale * joint_2, speed_scale * joint_3
    controller, exploration = servo.controller, servo.exploration
    return replace(
        servo,
        gate=replace(servo.gate, speed=max_rates),
        controller=replace(controller, max_speed=speed_scale * controller.max_speed),
        exploration=replace(exploration, max_time=exploration.max_time / speed_scale),
    )
