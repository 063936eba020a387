"""Confirmation of the person at the arm before its drive is switched on."""

from collections.abc import Callable

from rcmservo.errors import BadInput, Stopped, require
from rcmservo.rig.rig import Rig
from rcmservo.servo.servo import Servo

ENABLE_WORD = "enable"
"""Word that the operator types to enable the drive."""

CONFIRM_EXPECTED = (
    "a function that asks the person at the arm, such as input; a simulation of your own may set "
    "rig.is_simulated = True instead"
)

Confirm = Callable[[str], str]
"""Function that shows a question to the person at the arm and returns the answer, as `input`."""


def require_confirmation(
    rig: Rig, servo: Servo, duration_s: float, confirm: Confirm | None
) -> None:
    """Ask the person at a real arm for consent; without a real arm no question is needed.

    Raises
    ------
    BadInput
        If there is nobody to ask.
    Stopped
        If the answer is not the word that enables the drive.
    """
    if confirm is None:
        if rig.is_simulated:
            return
        raise BadInput("confirm", None, CONFIRM_EXPECTED)
    require(callable(confirm), "confirm", confirm, CONFIRM_EXPECTED)
    theta, phi, rho = servo.gate.speed
    limits = f"The joints move at most at {theta:g} rad/s, {phi:g} rad/s and {rho:g} mm/s."
    announcement = announce_motion(servo, duration_s, limits)
    question = f"{announcement} Type {ENABLE_WORD} to switch the drive on: "
    if str(confirm(question)).strip() != ENABLE_WORD:
        raise Stopped(f"the drive was not switched on: the answer was not {ENABLE_WORD}")


def announce_motion(servo: Servo, duration_s: float, limits: str) -> str:
    """Return the announcement of the motion that follows once the drive is on.

    `limits` is a sentence on the limits of the joints.
    """
    return (
        f"Once the drive is on, the servo moves the arm for at most {duration_s:g} s: first a "
        f"short distance around its start, at most {servo.exploration.max_leg_length:g} mm between "
        f"two corners of the path of marker 1, and then to the target. {limits} Ctrl-C stops the "
        "arm; keep the emergency stop within reach."
    )
