"""Which command a text is, and what it does."""

import re

from rcmservo.hardware.galil.emulator.commands import motion, reports, settings, threads
from rcmservo.hardware.galil.emulator.numbers import Refusal
from rcmservo.hardware.galil.emulator.state import Caller, ControllerState, Execute

COMMANDS: dict[str, Execute] = {
    **{name: settings.set_axes(name) for name in (*settings.RANGES, *settings.KEPT)},
    **dict.fromkeys(
        ("BA", "BI", "BN", "BP", "BV", "CB", "DV", "IH", "LZ", "NO", "PF", "SB", "VF"),
        settings.accept,
    ),
    "AB": motion.abort,
    "AM": motion.after_motion,
    "BG": motion.begin,
    "CN": settings.set_polarity,
    "CW": settings.mark_messages,
    "DL": threads.load,
    "DM": settings.dimension,
    "DP": settings.define_position,
    "ELSE": threads.else_,
    "EN": threads.end,
    "ENDIF": threads.end_if,
    "HX": threads.halt,
    "ID": reports.identity,
    "IF": threads.if_,
    "JP": threads.jump,
    "JS": threads.jump_subroutine,
    "MC": motion.after_motion,
    "MG": reports.message,
    "MO": motion.motor_off,
    "QZ": reports.sizes,
    "RE": threads.end,
    "RP": reports.of_axes(lambda axis: round(axis.reference)),
    "SC": reports.of_axes(lambda axis: axis.stop_code),
    "SH": motion.servo_here,
    "ST": motion.stop,
    "TC": reports.tell_code,
    "TD": reports.of_axes(lambda _: 0.0),
    "TE": reports.of_axes(lambda axis: round(axis.reference) - round(axis.position)),
    "TH": reports.all_handles,
    "TM": settings.set_sample_time,
    "TP": reports.of_axes(lambda axis: round(axis.position)),
    "TS": reports.tell_switches,
    "TT": reports.of_axes(lambda _: 0.0, 4),
    "TV": reports.of_axes(lambda axis: round(axis.velocity)),
    "WH": reports.own_handle,
    "WT": threads.wait,
    "XQ": threads.execute_program,
}
"""All but those that need the wire or the power: BZ, CF, DR, EO, QR, RS and UL are the
controller's."""

MODEL = "\x12\x16"

ASSIGNMENT = re.compile(r"([A-Za-z][A-Za-z0-9]{0,7})\s*(\[.*\])?\s*=")


def word_of(text: str) -> str:
    """The command that a text begins with; empty where it begins with none, or assigns."""
    match = re.match(r"(ELSE|ENDIF|[A-Z]{2})", text)
    return match.group(1) if match is not None and not _assigns(text, match.group(1)) else ""


def _assigns(text: str, word: str) -> bool:
    """Whether a text that begins like a command gives a variable a value."""
    match = ASSIGNMENT.match(text)
    if match is None:
        return False
    axes = match.group(1)[len(word) :]
    return match.group(2) is not None or re.fullmatch(r"[A-HW-Z]*", axes) is None


def execute(state: ControllerState, text: str, caller: Caller) -> str:
    """Do what a command says; what it answers. Refused where it cannot be done."""
    text = text.strip()
    if text == MODEL:
        return reports.model(state)
    if not text or text.startswith("'"):
        return ""
    word = word_of(text)
    if word in COMMANDS:
        return COMMANDS[word](state, text[len(word) :], caller)
    if ASSIGNMENT.match(text):
        return settings.assign(state, text)
    raise Refusal(1)
