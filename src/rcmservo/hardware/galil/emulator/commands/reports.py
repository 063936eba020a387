"""Commands that tell something."""

import re
from collections.abc import Callable

from rcmservo.hardware.galil import data_record as record
from rcmservo.hardware.galil.emulator.axis import Axis, MoveMode
from rcmservo.hardware.galil.emulator.commands.arguments import axes_in, split
from rcmservo.hardware.galil.emulator.expressions import value_of
from rcmservo.hardware.galil.emulator.numbers import Refusal, listed, shown
from rcmservo.hardware.galil.emulator.state import (
    HANDLES,
    LETTERS,
    Caller,
    ControllerState,
    Execute,
    Host,
    running,
)

FIRMWARE = "1.2b"
LONGEST_TEXT = 76


def of_axes(tell: Callable[[Axis], float], digits: int = 0) -> Execute:
    """The command that tells one number of each axis."""

    def command(state: ControllerState, rest: str, _: Caller) -> str:
        places = axes_in(rest, len(state.axes))
        return listed([tell(state.axes[place]) for place in places], digits)

    return command


def switches(axis: Axis, polarity: int) -> int:
    """The bits of TS but for the latch."""
    untripped = 1 if polarity == -1 else 0
    forward, reverse = int(axis.forward) ^ untripped, int(axis.reverse) ^ untripped
    too_large = abs(axis.error) > axis.settings.ER
    bits = (axis.moving, 7), (too_large, 6), (axis.off, 5), (forward, 3), (reverse, 2), (1, 1)
    return sum(int(bit) << place for bit, place in bits)


def tell_switches(state: ControllerState, rest: str, _: Caller) -> str:
    """TS: limit switches and what else an axis is in, as bits."""
    places = axes_in(rest, len(state.axes))
    return listed([switches(state.axes[place], state.polarity) for place in places])


def tell_code(state: ControllerState, rest: str, _: Caller) -> str:
    """TC: why the last command was refused, which is forgotten then; TC1 in words."""
    which = rest.strip()
    words = state.words_of_error() if which == "1" else str(state.error)
    state.error = 0
    return words


def message(state: ControllerState, rest: str, caller: Caller) -> str:
    """MG: numbers and texts. From a thread nobody asked for it."""
    match = re.match(r"\s*\{([EPU])([A-H0-9])\}\s*,?", rest)
    to, rest = (match.group(2), rest[match.end() :]) if match else ("", rest)
    text = "".join(_told(state, part) for part in split(rest))
    if isinstance(caller, Host):
        return text
    state.tell(text, to)
    return ""


def _told(state: ControllerState, part: str) -> str:
    match = re.fullmatch(r'"(.*)"', part)
    if match is not None:
        if len(match.group(1)) > LONGEST_TEXT:
            raise Refusal(52)
        return match.group(1)
    match = re.fullmatch(r"(.*?)\s*\{([FZ])(\d+)\.(\d+)\}", part)
    if match is not None:
        return f" {value_of(match.group(1), state):.{int(match.group(4))}f}"
    if part.startswith("{") or part.endswith("}"):
        raise Refusal(53)
    return shown(value_of(part, state))


def sizes(state: ControllerState, rest: str, _: Caller) -> str:
    """QZ: of what the data record is made."""
    return listed([len(state.axes), *record.SIZES])


def model(state: ControllerState) -> str:
    """The answer to the bytes 0x12 0x16."""
    return f"DMC40{len(state.axes)}0 Rev {FIRMWARE}"


def identity(state: ControllerState, rest: str, _: Caller) -> str:
    """ID: what the controller is made of."""
    return f"FW, {model(state)}\r\nDMC, 4000, Rev 1"


def own_handle(state: ControllerState, rest: str, caller: Caller) -> str:
    """WH: by which handle the host is connected."""
    if not isinstance(caller, Host):
        raise Refusal(3)
    return f"IH{LETTERS[caller.handle]}" if caller.handle < HANDLES else "RS232"


def all_handles(state: ControllerState, rest: str, _: Caller) -> str:
    """TH: who is connected."""
    lines = ["CONTROLLER IP ADDRESS 127,0,0,1 ETHERNET ADDRESS 00-00-00-00-00-00"]
    for i in range(HANDLES):
        used = "TCP PORT 23" if state.handles[i] else "AVAILABLE"
        lines.append(f"IH{LETTERS[i]} {used}")
    return "\r\n".join(lines)


def data_record(state: ControllerState) -> bytes:
    """The bytes that QR answers with."""
    general, rows = record.blank(len(state.axes))
    general["sample"] = state.samples & 0xFFFF
    general["error"], general["threads"] = state.error, running(state)
    general["amplifier"] = int.from_bytes(bytes(state.amplifier))
    general["handles"], general["inputs"] = state.handles, 255
    for axis, row in zip(state.axes, rows, strict=True):
        row["status"] = status(axis)
        row["switches"] = switches(axis, state.polarity) & 0b1110
        row["stop"] = axis.stop_code
        row["reference"], row["position"] = round(axis.reference), round(axis.position)
        row["error"] = round(axis.reference) - round(axis.position)
        row["velocity"] = round(record.VELOCITY * axis.velocity)
        row["user"] = int(axis.settings.ZA)
    return record.packed(record.DataRecord(general, rows))


def status(axis: Axis) -> int:
    """The bits of an axis' status in the data record."""
    positioning = axis.moving and axis.mode is not MoveMode.JOG
    wanted = axis.settings.JG if axis.mode is MoveMode.JOG else axis.settings.SP
    slewing = axis.moving and not axis.stopping and abs(axis.speed) == abs(wanted)
    bits = (
        (axis.moving, record.MOVING),
        (positioning, record.POSITIONING),
        (axis.speed < 0.0, record.NEGATIVE),
        (slewing, record.SLEWING),
        (axis.stopping, record.STOPPING),
        (axis.off, record.OFF),
    )
    return sum(bit for set_, bit in bits if set_)
