"""Commands that set and report values of axes, variables, arrays and the controller.

Source of ranges, steps and restrictions during motion: the page of each command in the command
reference.
"""

import re
from typing import NamedTuple

from rcmservo.hardware.galil.emulator.axis import MAX_POSITION, MIN_POSITION, Axis, MoveMode
from rcmservo.hardware.galil.emulator.commands.arguments import parse_assignments, split_arguments
from rcmservo.hardware.galil.emulator.expressions import evaluate, format_list, format_number
from rcmservo.hardware.galil.emulator.state import (
    MAX_VARIABLES,
    Caller,
    CommandHandler,
    ControllerState,
)
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode
from rcmservo.hardware.galil.settings import MAX_ACCELERATION, MIN_ACCELERATION

ARRAY_SPACE = 16000
"""Elements of all arrays together."""
MAX_SPEED = 22_000_000
"""Largest value of SP and JG in counts/s."""
MIN_SAMPLE_TIME_US, MAX_SAMPLE_TIME_US = 125.0, 20000.0
"""Range of TM for four axes."""


class SettingRange(NamedTuple):
    """Allowed values of an axis setting.

    Parameters
    ----------
    minimum : float
        Smallest value.
    maximum : float
        Largest value.
    step : float
        Step to which values are rounded towards zero; 0 for no rounding.
    only_at_rest : bool
        True if the setting cannot change during motion.
    """

    minimum: float
    maximum: float
    step: float = 0.0
    only_at_rest: bool = False


SETTING_RANGES = {
    **dict.fromkeys(
        ("AC", "DC", "SD"), SettingRange(MIN_ACCELERATION, MAX_ACCELERATION, MIN_ACCELERATION)
    ),
    "SP": SettingRange(0, MAX_SPEED, 2),
    "JG": SettingRange(-MAX_SPEED, MAX_SPEED, 2),
    "PR": SettingRange(MIN_POSITION, MAX_POSITION, 1, only_at_rest=True),
    "PA": SettingRange(MIN_POSITION, MAX_POSITION, 1, only_at_rest=True),
    "FL": SettingRange(MIN_POSITION, MAX_POSITION, 1),
    "BL": SettingRange(MIN_POSITION, MAX_POSITION, 1),
    "ER": SettingRange(-1, MAX_POSITION, 1),
    "OE": SettingRange(0, 3, 1),
    "LD": SettingRange(0, 3, 1),
    "ZA": SettingRange(MIN_POSITION, MAX_POSITION, 1),
    "MT": SettingRange(-3, 20, 0, only_at_rest=True),
}
"""Ranges of the settings that affect the emulated axes."""

STORED_SETTINGS = (
    *("KP", "KI", "KD", "IL", "IT", "TL", "TK", "OF", "FA", "FV", "PL", "NB", "NF", "NZ", "CE"),
    *("AG", "AU", "BM", "BW", "BO", "GA", "GR", "GM", "LC", "YA", "YB", "YC", "HV", "VA", "VD"),
    *("VS", "OA", "OV", "OT", "SA", "SS"),
)
"""Settings that are stored and reported without an effect."""

MOVE_MODES = {"JG": MoveMode.JOG, "PR": MoveMode.RELATIVE, "PA": MoveMode.ABSOLUTE}


def axis_setting(name: str) -> CommandHandler:
    """Return the command that sets or reports one setting of the axes."""

    def set_or_report(state: ControllerState, arguments: str, _: Caller) -> str | None:
        values: list[float] = []
        for index, text in parse_assignments(state, arguments):
            if text == "?":
                values.append(_read_setting(state, name, index))
            elif name in SETTING_RANGES:
                _change_setting(state.axes[index], name, evaluate(text, state))
            else:
                stored = state.stored_settings.setdefault(name, [0.0] * len(state.axes))
                stored[index] = evaluate(text, state)
        return format_list(values, 0 if name in SETTING_RANGES else 4) if values else None

    return set_or_report


def _read_setting(state: ControllerState, name: str, index: int) -> float:
    if name in SETTING_RANGES:
        return float(getattr(state.axes[index].settings, name))
    return state.stored_settings.get(name, [0.0] * len(state.axes))[index]


def _change_setting(axis: Axis, name: str, value: float) -> None:
    allowed = SETTING_RANGES[name]
    positioning = axis.moving and axis.mode is not MoveMode.JOG
    if name == "JG" and positioning:
        raise CommandError(ErrorCode.NOT_IN_JOG_MODE)
    is_fixed = name == "DC" and positioning and not axis.stopping
    if is_fixed or (allowed.only_at_rest and axis.moving):
        raise CommandError(ErrorCode.NOT_WHILE_RUNNING)
    if not allowed.minimum <= value <= allowed.maximum:
        raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
    if allowed.step:
        value = float(int(value / allowed.step) * allowed.step)
    setattr(axis.settings, name, value)
    if name in MOVE_MODES:
        axis.mode = MOVE_MODES[name]
    if name == "JG":
        axis.settings.SP = abs(value)


def define_position(state: ControllerState, arguments: str, _: Caller) -> str | None:
    """DP: set the value of the present position, or report it."""
    positions: list[float] = []
    for index, text in parse_assignments(state, arguments):
        axis = state.axes[index]
        if text == "?":
            positions.append(round(axis.position))
        elif axis.moving:
            raise CommandError(ErrorCode.NOT_WHILE_RUNNING)
        else:
            axis.define_position(round(evaluate(text, state)))
    return format_list(positions) if positions else None


def set_switch_polarity(state: ControllerState, arguments: str, _: Caller) -> str | None:
    """CN: set the level of a tripped limit switch, -1 for low and 1 for high."""
    text = split_arguments(arguments)[0]
    if text == "?":
        return format_list([state.switch_polarity])
    if text:
        polarity = evaluate(text, state)
        if polarity not in (-1.0, 1.0):
            raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
        state.switch_polarity = int(polarity)
    return None


def set_sample_time(state: ControllerState, arguments: str, _: Caller) -> str | None:
    """TM: store and report the sample time in us. The emulator keeps its own sample time."""
    text = split_arguments(arguments)[0]
    if text == "?":
        return format_list([state.sample_time_us], 4)
    sample_time_us = evaluate(text, state)
    if not MIN_SAMPLE_TIME_US <= sample_time_us <= MAX_SAMPLE_TIME_US:
        raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
    state.sample_time_us = sample_time_us
    return None


def mark_messages(state: ControllerState, arguments: str, _: Caller) -> str | None:
    """CW: set the high bit of unsolicited messages (1) or clear it (2); CW 0 returns the name."""
    text = split_arguments(arguments)[0]
    if text == "?":
        return format_list([1.0 if state.mark_unsolicited else 2.0])
    mode = evaluate(text, state) if text else 0.0
    if mode not in (0.0, 1.0, 2.0):
        raise CommandError(ErrorCode.NUMBER_OUT_OF_RANGE)
    if mode == 0.0:
        return "RCMSERVO EMULATOR OF A GALIL CONTROLLER"
    state.mark_unsolicited = mode == 1.0
    return None


def assign(state: ControllerState, text: str) -> str | None:
    """Execute name=value, name=?, name[index]=value or name[index]=?."""
    match = re.match(r"([A-Za-z][A-Za-z0-9]{0,7})\s*(?:\[(.+?)\])?\s*=\s*(.+)$", text)
    if match is None:
        raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)
    name, index_text, value_text = match.groups()
    if index_text is not None:
        array = state.array(name)
        index = state.array_index(array, evaluate(index_text, state))
        if value_text == "?":
            return format_number(array[index])
        array[index] = evaluate(value_text, state)
    elif value_text == "?":
        return format_number(state.variable(name))
    else:
        value = evaluate(value_text, state)
        if name not in state.variables and len(state.variables) == MAX_VARIABLES:
            raise CommandError(ErrorCode.TOO_MANY_VARIABLES)
        state.variables[name] = value
    return None


def dimension(state: ControllerState, arguments: str, _: Caller) -> str | None:
    """DM: create arrays; DM? reports the free elements."""
    free_elements = ARRAY_SPACE - sum(len(array) for array in state.arrays.values())
    if arguments.strip() == "?":
        return str(free_elements)
    for part in split_arguments(arguments):
        match = re.fullmatch(r"([A-Za-z][A-Za-z0-9]{0,7})\[(.+)\]", part)
        if match is None:
            raise CommandError(ErrorCode.MISSING_BRACKET)
        length = int(evaluate(match.group(2), state))
        if not 0 < length <= free_elements:
            raise CommandError(ErrorCode.ARRAY_SPACE_FULL)
        state.arrays[match.group(1)] = [0.0] * length
    return None


def accept(_: ControllerState, arguments: str, __: Caller) -> None:
    """Accept the configuration of hardware that is not emulated, without an effect."""
    if re.fullmatch(r"[-\s\d.,=?*<>A-HSTW-Z]*", arguments) is None:
        raise CommandError(ErrorCode.UNRECOGNIZED_COMMAND)
