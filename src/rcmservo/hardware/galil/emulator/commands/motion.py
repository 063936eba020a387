"""Commands that move, stop and switch axes."""

from rcmservo.hardware.galil.emulator.axis import Axis, StopCode
from rcmservo.hardware.galil.emulator.commands.arguments import axes_in
from rcmservo.hardware.galil.emulator.expressions import value_of
from rcmservo.hardware.galil.emulator.numbers import Refusal
from rcmservo.hardware.galil.emulator.state import Caller, ControllerState, Host


def begin(state: ControllerState, rest: str, _: Caller) -> str:
    """BG: set out. All of the axes that it names can, or none does."""
    axes = named(state, rest)
    for axis in axes:
        heads = axis.heads()
        if axis.off:
            raise Refusal(20)
        if axis.moving:
            raise Refusal(21)
        if (heads > 0.0 and not axis.may_forward) or (heads < 0.0 and not axis.may_reverse):
            raise Refusal(22)
    for axis in axes:
        axis.begin()
    return ""


def stop(state: ControllerState, rest: str, caller: Caller) -> str:
    """ST: come to rest. From a host that names no axis, the program ends too."""
    for axis in named(state, rest):
        axis.stop(StopCode.COMMAND)
    if not rest.strip() and isinstance(caller, Host):
        halt_all(state)
    return ""


def abort(state: ControllerState, rest: str, _: Caller) -> str:
    """AB: stand still at once; AB and AB 0 end the program too."""
    for axis in state.axes:
        axis.abort(StopCode.ABORTED)
        if axis.settings.OE in (1.0, 3.0):
            axis.switch_off()
    if not rest.strip() or value_of(rest, state) == 0.0:
        halt_all(state)
    return ""


def motor_off(state: ControllerState, rest: str, _: Caller) -> str:
    """MO: let the motors go; at rest alone."""
    for axis in _resting(state, rest):
        axis.switch_off()
    return ""


def servo_here(state: ControllerState, rest: str, _: Caller) -> str:
    """SH: hold the motors where they are; at rest alone."""
    for axis in _resting(state, rest):
        axis.switch_on()
    return ""


def after_motion(state: ControllerState, rest: str, caller: Caller) -> str:
    """AM, MC: go on when these axes have come to rest."""
    axes = named(state, rest)
    caller.wait = lambda: not any(axis.moving for axis in axes)
    return ""


def named(state: ControllerState, rest: str) -> list[Axis]:
    """The axes that a command names, all where it names none."""
    return [state.axes[place] for place in axes_in(rest, len(state.axes))]


def _resting(state: ControllerState, rest: str) -> list[Axis]:
    axes = named(state, rest)
    if any(axis.moving for axis in axes):
        raise Refusal(7)
    return axes


def halt_all(state: ControllerState) -> None:
    """End every thread of the program."""
    for thread in state.threads:
        thread.halt()
