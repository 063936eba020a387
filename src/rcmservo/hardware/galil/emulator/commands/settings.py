"""Commands that set or tell numbers: of axes, variables, arrays and of the whole controller.

Source of ranges, steps and what may change in motion: command reference, each command's page.
"""

import re
from typing import NamedTuple

from rcmservo.hardware.galil.emulator.axis import FAR, Axis, MoveMode
from rcmservo.hardware.galil.emulator.commands.arguments import assigned, split
from rcmservo.hardware.galil.emulator.expressions import value_of
from rcmservo.hardware.galil.emulator.numbers import Refusal, listed, shown
from rcmservo.hardware.galil.emulator.state import VARIABLES, Caller, ControllerState, Execute

ARRAY_SPACE = 16000
SAMPLE_TIMES = 125.0, 20000.0
"""us that TM takes of four axes."""


class Range(NamedTuple):
    """What a setting of an axis may be."""

    least: float
    """No less,"""
    most: float
    """and no more."""
    step: float = 0.0
    """Of which it is a multiple, rounded towards 0; 0 where it need not be."""
    resting: bool = False
    """Whether it may be set at rest alone."""


RANGES = {
    "AC": Range(1024, 1073740800, 1024),
    "DC": Range(1024, 1073740800, 1024),
    "SD": Range(1024, 1073740800, 1024),
    "SP": Range(0, 22000000, 2),
    "JG": Range(-22000000, 22000000, 2),
    "PR": Range(-FAR - 1, FAR, 1, resting=True),
    "PA": Range(-FAR - 1, FAR, 1, resting=True),
    "FL": Range(-FAR - 1, FAR, 1),
    "BL": Range(-FAR - 1, FAR, 1),
    "ER": Range(-1, FAR, 1),
    "OE": Range(0, 3, 1),
    "LD": Range(0, 3, 1),
    "ZA": Range(-FAR - 1, FAR, 1),
    "MT": Range(-3, 20, 0, resting=True),
}
"""Of the settings that the emulated axes go by."""

KEPT = (
    *("KP", "KI", "KD", "IL", "IT", "TL", "TK", "OF", "FA", "FV", "PL", "NB", "NF", "NZ", "CE"),
    *("AG", "AU", "BM", "BW", "BO", "GA", "GR", "GM", "LC", "YA", "YB", "YC", "HV", "VA", "VD"),
    *("VS", "OA", "OV", "OT", "SA", "SS"),
)
"""Settings that are kept and told, and do nothing here."""

MODES = {"JG": MoveMode.JOG, "PR": MoveMode.RELATIVE, "PA": MoveMode.ABSOLUTE}


def set_axes(name: str) -> Execute:
    """The command that sets or tells this setting of the axes."""

    def command(state: ControllerState, rest: str, _: Caller) -> str:
        told: list[float] = []
        for place, text in assigned(rest, len(state.axes)):
            if text == "?":
                told.append(_setting(state, name, place))
            elif name in RANGES:
                _set(state.axes[place], name, value_of(text, state))
            else:
                kept = state.kept.setdefault(name, [0.0] * len(state.axes))
                kept[place] = value_of(text, state)
        return listed(told, 0 if name in RANGES else 4) if told else ""

    return command


def _setting(state: ControllerState, name: str, place: int) -> float:
    if name in RANGES:
        return float(getattr(state.axes[place].settings, name))
    return state.kept.get(name, [0.0] * len(state.axes))[place]


def _set(axis: Axis, name: str, value: float) -> None:
    allowed = RANGES[name]
    positioning = axis.moving and axis.mode is not MoveMode.JOG
    if name == "JG" and positioning:
        raise Refusal(13)
    if (allowed.resting and axis.moving) or (name == "DC" and positioning and not axis.stopping):
        raise Refusal(7)
    if not allowed.least <= value <= allowed.most:
        raise Refusal(6)
    if allowed.step:
        value = float(int(value / allowed.step) * allowed.step)
    setattr(axis.settings, name, value)
    if name in MODES:
        axis.mode = MODES[name]
    if name == "JG":
        axis.settings.SP = abs(value)


def define_position(state: ControllerState, rest: str, _: Caller) -> str:
    """DP: call the place where an axis is by a number."""
    told: list[float] = []
    for place, text in assigned(rest, len(state.axes)):
        axis = state.axes[place]
        if text == "?":
            told.append(round(axis.position))
        elif axis.moving:
            raise Refusal(7)
        else:
            axis.define(round(value_of(text, state)))
    return listed(told) if told else ""


def set_polarity(state: ControllerState, rest: str, _: Caller) -> str:
    """CN: -1 where a limit switch is low when tripped, 1 where it is high."""
    first = split(rest)[0]
    if first == "?":
        return listed([state.polarity])
    if first:
        value = value_of(first, state)
        if value not in (-1.0, 1.0):
            raise Refusal(6)
        state.polarity = int(value)
    return ""


def set_sample_time(state: ControllerState, rest: str, _: Caller) -> str:
    """TM: us of a sample, which are kept and told; here a sample stays what it is."""
    first = split(rest)[0]
    if first == "?":
        return listed([state.sample_time], 4)
    value = value_of(first, state)
    if not SAMPLE_TIMES[0] <= value <= SAMPLE_TIMES[1]:
        raise Refusal(6)
    state.sample_time = value
    return ""


def assign(state: ControllerState, text: str) -> str:
    """name=value, name=?, name[place]=value and name[place]=?."""
    match = re.match(r"([A-Za-z][A-Za-z0-9]{0,7})\s*(?:\[(.+?)\])?\s*=\s*(.+)$", text)
    if match is None:
        raise Refusal(1)
    name, index, right = match.groups()
    if index is not None:
        array = state.array(name)
        place = state.place(array, value_of(index, state))
        if right == "?":
            return shown(array[place])
        array[place] = value_of(right, state)
    elif right == "?":
        return shown(state.variable(name))
    else:
        value = value_of(right, state)
        if name not in state.variables and len(state.variables) == VARIABLES:
            raise Refusal(67)
        state.variables[name] = value
    return ""


def dimension(state: ControllerState, rest: str, _: Caller) -> str:
    """DM: make arrays; DM? tells the space that is left."""
    used = sum(len(array) for array in state.arrays.values())
    if rest.strip() == "?":
        return str(ARRAY_SPACE - used)
    for part in split(rest):
        match = re.fullmatch(r"([A-Za-z][A-Za-z0-9]{0,7})\[(.+)\]", part)
        if match is None:
            raise Refusal(55)
        length = int(value_of(match.group(2), state))
        if not 0 < length <= ARRAY_SPACE - used:
            raise Refusal(66)
        state.arrays[match.group(1)] = [0.0] * length
    return ""


def mark_messages(state: ControllerState, rest: str, _: Caller) -> str:
    """CW: whether what nobody asked for has its high bits set."""
    first = split(rest)[0]
    if first == "?":
        return listed([1.0 if state.mark_unsolicited else 2.0])
    value = value_of(first, state) if first else 0.0
    if value not in (0.0, 1.0, 2.0):
        raise Refusal(6)
    if value:
        state.mark_unsolicited = value == 1.0
        return ""
    return "RCMSERVO EMULATOR OF A GALIL CONTROLLER"


def accept(_: ControllerState, rest: str, __: Caller) -> str:
    """What changes nothing here: configurations of hardware that is not emulated."""
    if re.fullmatch(r"[-\s\d.,=?*<>A-HSTW-Z]*", rest) is None:
        raise Refusal(1)
    return ""
