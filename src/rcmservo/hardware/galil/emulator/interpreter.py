"""Command table of the emulated controller, and dispatch of a command text to its handler."""

import re
from functools import lru_cache

from rcmservo.hardware.galil.emulator.commands import assignments, motion, reports, threads
from rcmservo.hardware.galil.emulator.state import (
    AXIS_OPERANDS,
    CACHED_TEXTS,
    Caller,
    CommandHandler,
    ControllerState,
)
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode

COMMANDS: dict[str, CommandHandler] = {
    **{
        name: assignments.axis_setting(name)
        for name in (*assignments.SETTING_RANGES, *assignments.STORED_SETTINGS)
    },
    **dict.fromkeys(
        ("BA", "BI", "BN", "BP", "BV", "CB", "DV", "IH", "LZ", "NO", "PF", "SB", "VF"),
        assignments.accept,
    ),
    **{name: reports.axis_report(AXIS_OPERANDS[name]) for name in ("RP", "SC", "TD", "TP", "TV")},
    "AB": motion.abort,
    "AM": motion.wait_for_motion_end,
    "BG": motion.begin,
    "CN": assignments.set_switch_polarity,
    "CW": assignments.mark_messages,
    "DL": threads.download,
    "DM": assignments.dimension,
    "DP": assignments.define_position,
    "ELSE": threads.else_,
    "EN": threads.end,
    "ENDIF": threads.end_if,
    "HX": threads.halt,
    "ID": reports.report_identity,
    "IF": threads.if_,
    "JP": threads.jump,
    "JS": threads.jump_subroutine,
    "MC": motion.wait_for_motion_end,
    "MG": reports.send_message,
    "MO": motion.switch_motors_off,
    "QZ": reports.report_block_sizes,
    "RE": threads.end,
    "SH": motion.servo_here,
    "ST": motion.stop,
    "TC": reports.report_error,
    "TE": reports.axis_report(lambda axis: round(axis.reference) - round(axis.position)),
    "TH": reports.report_handles,
    "TM": assignments.set_sample_time,
    "TS": reports.report_switches,
    "TT": reports.axis_report(AXIS_OPERANDS["TT"], 4),
    "WH": reports.report_own_handle,
    "WT": threads.wait,
    "XQ": threads.execute_program,
}
"""Handlers by command. :mod:`rcmservo.hardware.galil.emulator.controller` executes BZ, CF, DR, EO,
QR, RS and UL, which need the host connections or the amplifiers."""

MODEL_QUERY = "\x12\x16"

ASSIGNMENT = re.compile(r"([A-Za-z][A-Za-z0-9]{0,7})\s*(\[.*\])?\s*=")


def execute(state: ControllerState, text: str, caller: Caller) -> str | None:
    """Execute a command and return its reply data, or raise :class:`CommandError`."""
    text = text.strip()
    if text == MODEL_QUERY:
        return reports.format_model(state)
    if not text or text.startswith("'"):
        return None
    name = command_name(text)
    if name in COMMANDS:
        return COMMANDS[name](state, text[len(name) :], caller)
    if ASSIGNMENT.match(text):
        return assignments.assign(state, text)
    raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)


@lru_cache(CACHED_TEXTS)
def command_name(text: str) -> str:
    """Return the command at the start of a text, empty for an assignment or an unknown text."""
    match = re.match(r"(ELSE|ENDIF|[A-Z]{2})", text)
    return match.group(1) if match is not None and not _is_assignment(text, match.group(1)) else ""


def _is_assignment(text: str, name: str) -> bool:
    """Return True if a text that starts with a command's name assigns to a variable."""
    match = ASSIGNMENT.match(text)
    if match is None:
        return False
    variable, array_index = match.groups()
    axes = variable[len(name) :]
    return array_index is not None or re.fullmatch(r"[A-HW-Z]*", axes) is None
