"""Commands that set and report values of axes, variables, arrays and the controller.

Source of ranges, steps and restrictions during motion: the page of each command in the command
reference.
"""

import re
from typing import NamedTuple

from rcmservo.hardware.galil.emulator.axis import NO_SOFT_LIMIT, Axis, MoveMode
from rcmservo.hardware.galil.emulator.commands.arguments import (
    parse_assignments,
    split_arguments,
)
from rcmservo.hardware.galil.emulator.expressions import (
    CommandError,
    evaluate,
    format_list,
    format_number,
)
from rcmservo.hardware.galil.emulator.state import (
    MAX_VARIABLES,
    Caller,
    CommandHandler,
    ControllerState,
)

ARRAY_SPACE = 16000
"""Elements of all arrays together."""
SAMPLE_TIME_RANGE_US = 125.0, 20000.0
"""Range of TM for four axes, us."""


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
    "AC": SettingRange(1024, 1073740800, 1024),
    "DC": SettingRange(1024, 1073740800, 1024),
    "SD": SettingRange(1024, 1073740800, 1024),
    "SP": SettingRange(0, 22000000, 2),
    "JG": SettingRange(-22000000, 22000000, 2),
    "PR": SettingRange(-NO_SOFT_LIMIT - 1, NO_SOFT_LIMIT, 1, only_at_rest=True),
    "PA": SettingRange(-NO_SOFT_LIMIT - 1, NO_SOFT_LIMIT, 1, only_at_rest=True),
    "FL": SettingRange(-NO_SOFT_LIMIT - 1, NO_SOFT_LIMIT, 1),
    "BL": SettingRange(-NO_SOFT_LIMIT - 1, NO_SOFT_LIMIT, 1),
    "ER": SettingRange(-1, NO_SOFT_LIMIT, 1),
    "OE": SettingRange(0, 3, 1),
    "LD": SettingRange(0, 3, 1),
    "ZA": SettingRange(-NO_SOFT_LIMIT - 1, NO_SOFT_LIMIT, 1),
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

    def command(state: ControllerState, rest: str, _: Caller) -> str:
        values: list[float] = []
        for index, text in parse_assignments(rest, len(state.axes)):
            if text == "?":
                values.append(_read_setting(state, name, index))
            elif name in SETTING_RANGES:
                _change_setting(state.axes[index], name, evaluate(text, state))
            else:
                stored = state.stored_settings.setdefault(name, [0.0] * len(state.axes))
                stored[index] = evaluate(text, state)
        return format_list(values, 0 if name in SETTING_RANGES else 4) if values else ""

    return command


def _read_setting(state: ControllerState, name: str, index: int) -> float:
    if name in SETTING_RANGES:
        return float(getattr(state.axes[index].settings, name))
    return state.stored_settings.get(name, [0.0] * len(state.axes))[index]


def _change_setting(axis: Axis, name: str, value: float) -> None:
    allowed = SETTING_RANGES[name]
    positioning = axis.moving and axis.mode is not MoveMode.JOG
    if name == "JG" and positioning:
        raise CommandError(13)
    if allowed.only_at_rest and axis.moving:
        raise CommandError(7)
    if name == "DC" and positioning and not axis.stopping:
        raise CommandError(7)
    if not allowed.minimum <= value <= allowed.maximum:
        raise CommandError(6)
    if allowed.step:
        value = float(int(value / allowed.step) * allowed.step)
    setattr(axis.settings, name, value)
    if name in MOVE_MODES:
        axis.mode = MOVE_MODES[name]
    if name == "JG":
        axis.settings.SP = abs(value)


def define_position(state: ControllerState, rest: str, _: Caller) -> str:
    """DP: set the value of the present position, or report it."""
    values: list[float] = []
    for index, text in parse_assignments(rest, len(state.axes)):
        axis = state.axes[index]
        if text == "?":
            values.append(round(axis.position))
        elif axis.moving:
            raise CommandError(7)
        else:
            axis.define_position(round(evaluate(text, state)))
    return format_list(values) if values else ""


def set_switch_polarity(state: ControllerState, rest: str, _: Caller) -> str:
    """CN: set the level of a tripped limit switch, -1 for low and 1 for high."""
    first = split_arguments(rest)[0]
    if first == "?":
        return format_list([state.switch_polarity])
    if first:
        value = evaluate(first, state)
        if value not in (-1.0, 1.0):
            raise CommandError(6)
        state.switch_polarity = int(value)
    return ""


def set_sample_time(state: ControllerState, rest: str, _: Caller) -> str:
    """TM: store and report the sample time in us. The emulator keeps its own sample time."""
    first = split_arguments(rest)[0]
    if first == "?":
        return format_list([state.sample_time_us], 4)
    value = evaluate(first, state)
    if not SAMPLE_TIME_RANGE_US[0] <= value <= SAMPLE_TIME_RANGE_US[1]:
        raise CommandError(6)
    state.sample_time_us = value
    return ""


def assign(state: ControllerState, text: str) -> str:
    """Execute name=value, name=?, name[index]=value or name[index]=?."""
    match = re.match(r"([A-Za-z][A-Za-z0-9]{0,7})\s*(?:\[(.+?)\])?\s*=\s*(.+)$", text)
    if match is None:
        raise CommandError(1)
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
            raise CommandError(67)
        state.variables[name] = value
    return ""


def dimension(state: ControllerState, rest: str, _: Caller) -> str:
    """DM: create arrays; DM? reports the free elements."""
    used = sum(len(array) for array in state.arrays.values())
    if rest.strip() == "?":
        return str(ARRAY_SPACE - used)
    for part in split_arguments(rest):
        match = re.fullmatch(r"([A-Za-z][A-Za-z0-9]{0,7})\[(.+)\]", part)
        if match is None:
            raise CommandError(55)
        length = int(evaluate(match.group(2), state))
        if not 0 < length <= ARRAY_SPACE - used:
            raise CommandError(66)
        state.arrays[match.group(1)] = [0.0] * length
    return ""


def mark_messages(state: ControllerState, rest: str, _: Caller) -> str:
    """CW: set the high bit of unsolicited messages (1) or clear it (2); CW 0 returns the name."""
    first = split_arguments(rest)[0]
    if first == "?":
        return format_list([1.0 if state.mark_unsolicited else 2.0])
    value = evaluate(first, state) if first else 0.0
    if value not in (0.0, 1.0, 2.0):
        raise CommandError(6)
    if value:
        state.mark_unsolicited = value == 1.0
        return ""
    return "RCMSERVO EMULATOR OF A GALIL CONTROLLER"


def accept(_: ControllerState, rest: str, __: Caller) -> str:
    """Accept the configuration of hardware that is not emulated, without an effect."""
    if re.fullmatch(r"[-\s\d.,=?*<>A-HSTW-Z]*", rest) is None:
        raise CommandError(1)
    return ""
