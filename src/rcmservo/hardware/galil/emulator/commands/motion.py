"""Commands that move and stop axes and switch motors."""

from rcmservo.hardware.galil.emulator.axis import Axis, StopCode
from rcmservo.hardware.galil.emulator.commands.arguments import select_axes
from rcmservo.hardware.galil.emulator.expressions import evaluate
from rcmservo.hardware.galil.emulator.state import Caller, ControllerState, Host
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode


def begin(state: ControllerState, arguments: str, _: Caller) -> None:
    """BG: start the motion of all named axes, or of none if one of them cannot move."""
    axes = select_axes(state, arguments)
    for axis in axes:
        motion = axis.commanded_motion()
        if axis.motor_off:
            raise CommandError(ErrorCode.BEGIN_WITH_MOTOR_OFF)
        if axis.moving:
            raise CommandError(ErrorCode.BEGIN_WHILE_RUNNING)
        at_forward_limit = motion > 0.0 and not axis.can_move_forward
        if at_forward_limit or (motion < 0.0 and not axis.can_move_reverse):
            raise CommandError(ErrorCode.BEGIN_AT_LIMIT)
    for axis in axes:
        axis.begin()


def stop(state: ControllerState, arguments: str, caller: Caller) -> None:
    """ST: decelerate to rest. A host's ST without axes also ends the program."""
    for axis in select_axes(state, arguments):
        axis.stop(StopCode.COMMAND)
    if not arguments.strip() and isinstance(caller, Host):
        state.halt_threads()


def abort(state: ControllerState, arguments: str, _: Caller) -> None:
    """AB: stop all axes at once. AB and AB 0 also end the program."""
    for axis in state.axes:
        axis.abort(StopCode.ABORTED)
        if axis.switches_off_on_error:
            axis.switch_off()
    if not arguments.strip() or evaluate(arguments, state) == 0.0:
        state.halt_threads()


def switch_motors_off(state: ControllerState, arguments: str, _: Caller) -> None:
    """MO: switch motors off. Refused while an axis moves."""
    for axis in _select_resting_axes(state, arguments):
        axis.switch_off()


def servo_here(state: ControllerState, arguments: str, _: Caller) -> None:
    """SH: switch motors on and hold their positions. Refused while an axis moves."""
    for axis in _select_resting_axes(state, arguments):
        axis.switch_on()


def wait_for_motion_end(state: ControllerState, arguments: str, caller: Caller) -> None:
    """AM, MC: wait until the axes are at rest."""
    axes = select_axes(state, arguments)
    caller.resume_condition = lambda: not any(axis.moving for axis in axes)


def _select_resting_axes(state: ControllerState, arguments: str) -> list[Axis]:
    axes = select_axes(state, arguments)
    if any(axis.moving for axis in axes):
        raise CommandError(ErrorCode.NOT_WHILE_RUNNING)
    return axes
