"""Commands that report states and values."""

import re
from collections.abc import Callable

from rcmservo.hardware.galil import data_record as record
from rcmservo.hardware.galil.emulator.axis import Axis, MoveMode
from rcmservo.hardware.galil.emulator.commands.arguments import select_axes, split_arguments
from rcmservo.hardware.galil.emulator.expressions import evaluate, format_list, format_number
from rcmservo.hardware.galil.emulator.state import (
    HANDLE_COUNT,
    Caller,
    CommandHandler,
    ControllerState,
    Host,
)
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode

FIRMWARE = "1.2b"
MAX_TEXT_LENGTH = 76
"""Characters of a text in MG."""


def axis_report(read: Callable[[Axis], float], digits: int = 0) -> CommandHandler:
    """Return the command that reports one number per axis."""

    def report(state: ControllerState, arguments: str, _: Caller) -> str:
        return format_list([read(axis) for axis in select_axes(state, arguments)], digits)

    return report


def report_switches(state: ControllerState, arguments: str, _: Caller) -> str:
    """TS: report limit switches and axis state as bits."""
    axes = select_axes(state, arguments)
    return format_list([_encode_switches(axis, state.switch_polarity) for axis in axes])


def report_error(state: ControllerState, arguments: str, _: Caller) -> str:
    """TC: report and clear the code of the last error; TC1 adds its text."""
    text = state.error_text() if arguments.strip() == "1" else str(state.error)
    state.error = 0
    return text


def send_message(state: ControllerState, arguments: str, caller: Caller) -> str | None:
    """MG: report numbers and texts. From a thread they become an unsolicited message."""
    match = re.match(r"\s*\{[EPU](?P<destination>[A-H0-9])\}\s*,?", arguments)
    content = arguments[match.end() :] if match else arguments
    text = "".join(_format_message_part(state, part) for part in split_arguments(content))
    if isinstance(caller, Host):
        return text
    state.send_message(text, match["destination"] if match else "")
    return None


def _format_message_part(state: ControllerState, part: str) -> str:
    """Format one part of a message: a text in quotes, or a number with or without {Fm.n}."""
    match = re.fullmatch(r'"(.*)"', part)
    if match is not None:
        if len(match.group(1)) > MAX_TEXT_LENGTH:
            raise CommandError(ErrorCode.STRING_TOO_LONG)
        return match.group(1)
    match = re.fullmatch(r"(.*?)\s*\{[FZ]\d+\.(\d+)\}", part)
    if match is not None:
        return f" {evaluate(match.group(1), state):.{int(match.group(2))}f}"
    if part.startswith("{") or part.endswith("}"):
        raise CommandError(ErrorCode.ERROR_IN_BRACES)
    return format_number(evaluate(part, state))


def report_block_sizes(state: ControllerState, arguments: str, _: Caller) -> str:
    """QZ: report the axis count and the block sizes of the data record."""
    return format_list([len(state.axes), *record.BLOCK_SIZES])


def format_model(state: ControllerState) -> str:
    """Return the reply to the bytes 0x12 0x16."""
    return f"DMC40{len(state.axes)}0 Rev {FIRMWARE}"


def report_identity(state: ControllerState, arguments: str, _: Caller) -> str:
    """ID: report firmware and hardware."""
    return f"FW, {format_model(state)}\r\nDMC, 4000, Rev 1"


def report_own_handle(state: ControllerState, arguments: str, caller: Caller) -> str:
    """WH: report the handle of the host."""
    if not isinstance(caller, Host):
        raise CommandError(ErrorCode.NOT_IN_PROGRAM)
    return f"IH{record.AXIS_LETTERS[caller.handle]}" if caller.handle < HANDLE_COUNT else "RS232"


def report_handles(state: ControllerState, arguments: str, _: Caller) -> str:
    """TH: report the state of all handles."""
    lines = ["CONTROLLER IP ADDRESS 127,0,0,1 ETHERNET ADDRESS 00-00-00-00-00-00"]
    for letter, kind in zip(record.AXIS_LETTERS, state.handles, strict=True):
        lines.append(f"IH{letter} {'TCP PORT 23' if kind else 'AVAILABLE'}")
    return "\r\n".join(lines)


def encode_data_record(state: ControllerState) -> bytes:
    """Return the bytes of the data record (QR)."""
    general, rows = record.empty_record(len(state.axes))
    general["sample"] = state.samples & 0xFFFF
    general["error"], general["threads"] = state.error, state.running_thread_bits()
    general["amplifier"] = int.from_bytes(bytes(state.amplifier))
    general["handles"], general["inputs"] = state.handles, 255
    for axis, row in zip(state.axes, rows, strict=True):
        row["status"] = _encode_status(axis)
        row["switches"] = _encode_switches(axis, state.switch_polarity) & record.SWITCHES
        row["stop"] = axis.stop_code
        row["reference"], row["position"] = round(axis.reference), round(axis.position)
        row["error"] = round(axis.reference) - round(axis.position)
        row["velocity"] = round(record.VELOCITY_SCALE * axis.velocity)
        row["user"] = int(axis.settings.ZA)
    return record.encode_record(record.DataRecord(general, rows))


def _encode_switches(axis: Axis, polarity: int) -> int:
    """Return the bits of TS, without the latch. No home switch is connected."""
    tripped_level = polarity == 1
    forward_level = axis.forward_tripped == tripped_level
    reverse_level = axis.reverse_tripped == tripped_level
    has_large_error = abs(axis.error) > axis.settings.ER
    axis_bits = axis.moving << 7 | has_large_error << 6 | axis.motor_off << 5
    limit_bits = forward_level * record.FORWARD_SWITCH | reverse_level * record.REVERSE_SWITCH
    return axis_bits | limit_bits | record.HOME_SWITCH


def _encode_status(axis: Axis) -> int:
    """Return the status bits of an axis in the data record."""
    is_jog = axis.mode is MoveMode.JOG
    slew_speed = axis.settings.JG if is_jog else axis.settings.SP
    slewing = axis.moving and not axis.stopping and abs(axis.speed) == abs(slew_speed)
    profile_bits = axis.moving * record.MOVING | (axis.moving and not is_jog) * record.POSITIONING
    speed_bits = (axis.speed < 0.0) * record.NEGATIVE | slewing * record.SLEWING
    stop_bits = axis.stopping * record.STOPPING | axis.motor_off * record.MOTOR_OFF
    return profile_bits | speed_bits | stop_bits
