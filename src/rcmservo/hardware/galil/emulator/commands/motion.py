"""Commands that move and stop axes and switch motors."""

from rcmservo.hardware.galil.emulator.axis import Axis, StopCode
from rcmservo.hardware.galil.emulator.commands.arguments import parse_axes
from rcmservo.hardware.galil.emulator.expressions import CommandError, evaluate
from rcmservo.hardware.galil.emulator.state import Caller, ControllerState, Host


def begin(state: ControllerState, rest: str, _: Caller) -> str:
    """BG: start the motion of all named axes, or of none if one of them cannot move."""
    axes = select_axes(state, rest)
    for axis in axes:
        motion = axis.commanded_motion()
        if axis.motor_off:
            raise CommandError(20)
        if axis.moving:
            raise CommandError(21)
        if motion > 0.0 and not axis.can_move_forward:
            raise CommandError(22)
        if motion < 0.0 and not axis.can_move_reverse:
            raise CommandError(22)
    for axis in axes:
        axis.begin()
    return ""


def stop(state: ControllerState, rest: str, caller: Caller) -> str:
    """ST: decelerate to rest. A host's ST without axes also ends the program."""
    for axis in select_axes(state, rest):
        axis.stop(StopCode.COMMAND)
    if not rest.strip() and isinstance(caller, Host):
        halt_all_threads(state)
    return ""


def abort(state: ControllerState, rest: str, _: Caller) -> str:
    """AB: stop all axes at once. AB and AB 0 also end the program."""
    for axis in state.axes:
        axis.abort(StopCode.ABORTED)
        if axis.settings.OE in (1.0, 3.0):
            axis.switch_off()
    if not rest.strip() or evaluate(rest, state) == 0.0:
        halt_all_threads(state)
    return ""


def switch_motors_off(state: ControllerState, rest: str, _: Caller) -> str:
    """MO: switch motors off. Refused while an axis moves."""
    for axis in _select_resting_axes(state, rest):
        axis.switch_off()
    return ""


def servo_here(state: ControllerState, rest: str, _: Caller) -> str:
    """SH: switch motors on and hold their positions. Refused while an axis moves."""
    for axis in _select_resting_axes(state, rest):
        axis.switch_on()
    return ""


def wait_for_motion_end(state: ControllerState, rest: str, caller: Caller) -> str:
    """AM, MC: wait until the axes are at rest."""
    axes = select_axes(state, rest)
    caller.wait = lambda: not any(axis.moving for axis in axes)
    return ""


def select_axes(state: ControllerState, rest: str) -> list[Axis]:
    """Return the named axes, or all axes if none is named."""
    return [state.axes[index] for index in parse_axes(rest, len(state.axes))]


def _select_resting_axes(state: ControllerState, rest: str) -> list[Axis]:
    axes = select_axes(state, rest)
    if any(axis.moving for axis in axes):
        raise CommandError(7)
    return axes


def halt_all_threads(state: ControllerState) -> None:
    """End every thread of the program."""
    for thread in state.threads:
        thread.halt()
