"""A tenth of the speed, for a laboratory whose file nobody has checked.

Everything that bounds how fast the tool goes is scaled together: the gate's speeds, which no
command exceeds, and the law's own. The first motion gets shorter ways with the gate's speeds, and
as much longer to find those that tell enough. How soon joints slow down stays as it is.
"""

from dataclasses import replace

from rcmservo.servo.servo import Servo

SHARE = 0.1
"""Of the full speed."""


def cautious(servo: Servo, share: float = SHARE) -> Servo:
    """A servo that goes at most at this share of the speed of another one."""
    x, y, z = servo.gate.speed
    law, first = servo.controller, servo.exploration
    return replace(
        servo,
        gate=replace(servo.gate, speed=(share * x, share * y, share * z)),
        controller=replace(law, max_speed=share * law.max_speed),
        exploration=replace(first, max_time=first.max_time / share),
    )
