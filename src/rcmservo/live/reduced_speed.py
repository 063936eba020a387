"""Reduced speed for a lab whose rig file has not passed `rcmservo rig check`.

One factor scales all limits of the speed: those of the gate, which no command exceeds, and that of
the control law. Exploration moves along shorter paths at the lower speeds of the gate, so its time
limit grows by the same factor. Accelerations are not changed.
"""

from dataclasses import replace

from rcmservo.servo.servo import Servo

SHARE = 0.1
"""Fraction of the full speed for an unchecked lab."""


def cautious(servo: Servo, share: float = SHARE) -> Servo:
    """Return a servo whose speed limits are a fraction of another one's."""
    x, y, z = servo.gate.speed
    law, exploration = servo.controller, servo.exploration
    return replace(
        servo,
        gate=replace(servo.gate, speed=(share * x, share * y, share * z)),
        controller=replace(law, max_speed=share * law.max_speed),
        exploration=replace(exploration, max_time=exploration.max_time / share),
    )
