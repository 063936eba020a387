"""Commands that report states and values."""

import re
from collections.abc import Callable

from rcmservo.hardware.galil import data_record as record
from rcmservo.hardware.galil.emulator.axis import Axis, MoveMode
from rcmservo.hardware.galil.emulator.commands.arguments import parse_axes, split_arguments
from rcmservo.hardware.galil.emulator.expressions import (
    CommandError,
    evaluate,
    format_list,
    format_number,
)
from rcmservo.hardware.galil.emulator.state import (
    HANDLE_COUNT,
    Caller,
    CommandHandler,
    ControllerState,
    Host,
    running_thread_bits,
)

FIRMWARE = "1.2b"
MAX_TEXT_LENGTH = 76
"""Characters of a text in MG."""


def axis_report(read: Callable[[Axis], float], digits: int = 0) -> CommandHandler:
    """Return the command that reports one number per axis."""

    def command(state: ControllerState, rest: str, _: Caller) -> str:
        indices = parse_axes(rest, len(state.axes))
        return format_list([read(state.axes[index]) for index in indices], digits)

    return command


def switch_bits(axis: Axis, polarity: int) -> int:
    """Return the bits of TS, without the latch."""
    untripped = 1 if polarity == -1 else 0
    forward = int(axis.forward_tripped) ^ untripped
    reverse = int(axis.reverse_tripped) ^ untripped
    large_error = abs(axis.error) > axis.settings.ER
    bits = (
        (axis.moving, 7),
        (large_error, 6),
        (axis.motor_off, 5),
        (forward, 3),
        (reverse, 2),
        (1, 1),
    )
    return sum(int(value) << bit for value, bit in bits)


def report_switches(state: ControllerState, rest: str, _: Caller) -> str:
    """TS: report limit switches and axis state as bits."""
    indices = parse_axes(rest, len(state.axes))
    return format_list([switch_bits(state.axes[i], state.switch_polarity) for i in indices])


def report_error(state: ControllerState, rest: str, _: Caller) -> str:
    """TC: report and clear the code of the last error; TC1 adds its text."""
    text = state.error_text() if rest.strip() == "1" else str(state.error)
    state.error = 0
    return text


def send_message(state: ControllerState, rest: str, caller: Caller) -> str:
    """MG: report numbers and texts. From a thread they become an unsolicited message."""
    match = re.match(r"\s*\{([EPU])([A-H0-9])\}\s*,?", rest)
    destination, rest = (match.group(2), rest[match.end() :]) if match else ("", rest)
    text = "".join(_format_message_part(state, part) for part in split_arguments(rest))
    if isinstance(caller, Host):
        return text
    state.send_message(text, destination)
    return ""


def _format_message_part(state: ControllerState, part: str) -> str:
    match = re.fullmatch(r'"(.*)"', part)
    if match is not None:
        if len(match.group(1)) > MAX_TEXT_LENGTH:
            raise CommandError(52)
        return match.group(1)
    match = re.fullmatch(r"(.*?)\s*\{([FZ])(\d+)\.(\d+)\}", part)
    if match is not None:
        return f" {evaluate(match.group(1), state):.{int(match.group(4))}f}"
    if part.startswith("{") or part.endswith("}"):
        raise CommandError(53)
    return format_number(evaluate(part, state))


def report_block_sizes(state: ControllerState, rest: str, _: Caller) -> str:
    """QZ: report the axis count and the block sizes of the data record."""
    return format_list([len(state.axes), *record.BLOCK_SIZES])


def model_text(state: ControllerState) -> str:
    """Return the reply to the bytes 0x12 0x16."""
    return f"DMC40{len(state.axes)}0 Rev {FIRMWARE}"


def report_identity(state: ControllerState, rest: str, _: Caller) -> str:
    """ID: report firmware and hardware."""
    return f"FW, {model_text(state)}\r\nDMC, 4000, Rev 1"


def report_own_handle(state: ControllerState, rest: str, caller: Caller) -> str:
    """WH: report the handle of the host."""
    if not isinstance(caller, Host):
        raise CommandError(3)
    return f"IH{record.AXIS_LETTERS[caller.handle]}" if caller.handle < HANDLE_COUNT else "RS232"


def report_handles(state: ControllerState, rest: str, _: Caller) -> str:
    """TH: report the state of all handles."""
    lines = ["CONTROLLER IP ADDRESS 127,0,0,1 ETHERNET ADDRESS 00-00-00-00-00-00"]
    for i in range(HANDLE_COUNT):
        use = "TCP PORT 23" if state.handles[i] else "AVAILABLE"
        lines.append(f"IH{record.AXIS_LETTERS[i]} {use}")
    return "\r\n".join(lines)


def encode_data_record(state: ControllerState) -> bytes:
    """Return the bytes of the data record (QR)."""
    general, rows = record.empty_record(len(state.axes))
    general["sample"] = state.samples & 0xFFFF
    general["error"], general["threads"] = state.error, running_thread_bits(state)
    general["amplifier"] = int.from_bytes(bytes(state.amplifier))
    general["handles"], general["inputs"] = state.handles, 255
    for axis, row in zip(state.axes, rows, strict=True):
        row["status"] = status_bits(axis)
        row["switches"] = switch_bits(axis, state.switch_polarity) & 0b1110
        row["stop"] = axis.stop_code
        row["reference"], row["position"] = round(axis.reference), round(axis.position)
        row["error"] = round(axis.reference) - round(axis.position)
        row["velocity"] = round(record.VELOCITY_SCALE * axis.velocity)
        row["user"] = int(axis.settings.ZA)
    return record.encode_record(record.DataRecord(general, rows))


def status_bits(axis: Axis) -> int:
    """Return the status bits of an axis in the data record."""
    positioning = axis.moving and axis.mode is not MoveMode.JOG
    slew_speed = axis.settings.JG if axis.mode is MoveMode.JOG else axis.settings.SP
    slewing = axis.moving and not axis.stopping and abs(axis.speed) == abs(slew_speed)
    bits = (
        (axis.moving, record.MOVING),
        (positioning, record.POSITIONING),
        (axis.speed < 0.0, record.NEGATIVE),
        (slewing, record.SLEWING),
        (axis.stopping, record.STOPPING),
        (axis.motor_off, record.MOTOR_OFF),
    )
    return sum(bit for is_set, bit in bits if is_set)
