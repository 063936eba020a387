"""Reasons why a Galil controller stopped the arm: stop codes and amplifier errors, in words.

Sources: DMC-40x0 command reference, TC, SC and TA; DMC-40x0 user manual, Amplifier Status.
"""

from collections.abc import Sequence

from rcmservo.errors import quote_value
from rcmservo.hardware.galil.connection import CommandRejected, GalilConnection
from rcmservo.hardware.galil.data_record import AXIS_LETTERS
from rcmservo.hardware.galil.error_codes import ERROR_TEXTS
from rcmservo.hardware.galil.watchdog_program import AXIS_AT_REST, STOP_CAUSES
from rcmservo.live.device_protocols import NotReady

STOP_CODE_TEXTS = {
    0: "is in motion",
    1: "completed its move",
    2: "was stopped by its forward limit",
    3: "was stopped by its reverse limit",
    4: "was stopped by a stop command (ST)",
    6: "was stopped by the abort input",
    7: "was stopped by an abort command (AB)",
    8: "was switched off by a following error (position error above ER)",
    9: "found an edge (FE)",
    10: "was homed (HM)",
    11: "was stopped by a selective abort input",
    12: "was switched off by an encoder failure (OA)",
    15: "was switched off by a fault of its amplifier",
    16: "was stopped by stepper position maintenance",
    30: "runs in PVT mode",
    31: "completed its PVT motion",
    32: "left PVT mode because its buffer was empty",
    50: "runs in contour mode",
    51: "was stopped in contour mode",
    60: "runs as an electronic cam",
    61: "was stopped as an electronic cam",
    99: "did not come to rest in time (MC)",
    100: "runs in a coordinated motion",
    101: "was stopped in a coordinated motion",
}
"""States and stop reasons of an axis, by stop code (SC)."""

NORMAL_STOP_CODES = 0, 4
"""Stop codes of an axis that moves or that a stop command has stopped."""

AMPLIFIER_QUERY = "MG _TA0,_TA1,_TA3"
"""Query of the amplifier errors: supply and temperature, Hall sensors, lock-out inputs.

The query names each byte, because the sources disagree on the order of the bytes in the data
record. It omits TA2 (peak current), which is no error.
"""

SUPPLY_ERRORS = "over-current", "over-voltage", "over-temperature", "under-voltage"
"""Bits 0 to 3 of TA0, for axes A to D. The next four bits are those of axes E to H."""

AMPLIFIER_AXES = AXIS_LETTERS[:4], AXIS_LETTERS[4:]
"""Axes of each amplifier."""


def read_amplifier_errors(connection: GalilConnection, axes: str) -> list[str]:
    """Read the amplifier errors that concern some axes, one phrase per error.

    The list is empty for a controller without internal amplifiers.
    """
    try:
        values = connection.read_numbers(AMPLIFIER_QUERY)
    except CommandRejected:
        return []
    return decode_amplifier_errors(values, axes)


def decode_amplifier_errors(values: Sequence[float], axes: str) -> list[str]:
    """Decode the reply to ``AMPLIFIER_QUERY`` for some axes, one phrase per error."""
    if len(values) != 3 or not all(0 <= value < 256 for value in values):
        raise NotReady(
            f"{AMPLIFIER_QUERY} must return three bytes, got {quote_value(list(values))}"
        )
    supply, hall, lockout = (int(value) for value in values)
    errors: list[str] = []
    for amplifier, group in enumerate(AMPLIFIER_AXES):
        if set(axes).intersection(group):
            group_name = f"axes {group[0]}-{group[-1]}"
            for bit, error in enumerate(SUPPLY_ERRORS, len(SUPPLY_ERRORS) * amplifier):
                errors += [f"{error} on {group_name}"] if supply >> bit & 1 else []
            errors += [f"electronic lock-out of {group_name}"] if lockout >> amplifier & 1 else []
    hall_axes = [axis for axis in axes if hall >> AXIS_LETTERS.index(axis) & 1]
    return errors + [f"hall sensor error on axis {axis}" for axis in hall_axes]


def last_command_error(connection: GalilConnection) -> str:
    """Return the text of the last command error, empty if there is none since the last TC.

    Errors of the controller's own program count as well.
    """
    code = int(connection.read_number("_TC"))
    return ERROR_TEXTS.get(code, f"error {code}") if code else ""


def describe_stop(connection: GalilConnection, axes: str, stop_codes: Sequence[int]) -> str:
    """Describe why the axes stopped, from the watchdog program's cause and the stop codes."""
    cause = int(connection.read_variable("why"))
    watchdog_text = STOP_CAUSES.get(cause, "")
    if watchdog_text and cause != AXIS_AT_REST:
        return watchdog_text
    axis_texts = [
        f"axis {axis} {STOP_CODE_TEXTS.get(code, f'stopped with the unknown stop code {code}')}"
        for axis, code in zip(axes, stop_codes, strict=True)
        if code not in NORMAL_STOP_CODES
    ]
    if axis_texts:
        return "; ".join(axis_texts)
    return watchdog_text or last_command_error(connection) or "the motors went off"


def append_device_reports(
    cause: str, connection: GalilConnection, axes: str, last_message: str
) -> str:
    """Append the amplifier errors and the last unsolicited message of the controller to a cause."""
    parts = [cause, *read_amplifier_errors(connection, axes)]
    if last_message:
        parts.append(f"its last message was {quote_value(last_message)}")
    return "; ".join(parts)
