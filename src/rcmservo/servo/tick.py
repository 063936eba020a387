"""One tick from observation to command: as one compiled function, or around an estimator in Python.

A tick is one cycle of the loop. An estimator that does not compile runs in Python between
`begin_tick` and `finish_tick`. They call the same functions as the compiled tick, so that the
results are equal to the last bit. In a live loop the processor's caches are cold, and each array or
named tuple that passes from Python to a compiled function takes a noticeable part of the tick.
Therefore few are passed, and the state is overwritten in place.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from rcmservo.estimation.base import EstimatorKernel
from rcmservo.estimation.camera_fit import reset_fit
from rcmservo.geometry.kinematics import compute_position_tuple
from rcmservo.interfaces import Floats, ObservationStruct
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Rows
from rcmservo.safety.monitor_state import reset_monitor, store_observation
from rcmservo.servo.accept_frame import accept_frame
from rcmservo.servo.apply_mode import bound_rates, choose_mode
from rcmservo.servo.collect_causes import collect_causes, compare_target_with_fit
from rcmservo.servo.compute_command import compute_command
from rcmservo.servo.kernel_parameters import KernelParameters, TickContext, make_rcm_struct
from rcmservo.servo.setpoint import Setpoint, store_setpoint
from rcmservo.servo.state import StoredState, reset_estimation
from rcmservo.servo.target_gap import predict_target
from rcmservo.servo.update_estimate import (
    FRAME_UPDATES,
    empty_memory,
    fit_frame,
    store_estimate,
    update_estimator,
)


@cache
def make_compiled_tick(kind: type[EstimatorKernel]) -> Callable[..., tuple[Any, bool]]:
    """Return the compiled tick for a class of estimator kernels.

    The settings of the kernel pass as a plain tuple: a named one costs a twentieth of the tick.
    """
    kernel_class: Any = kind

    @compiled
    def tick(
        rows: Rows[StoredState],
        memory: Any,
        observation: tuple[Any, ...],
        setpoint: tuple[Any, ...],
        settings: tuple[Any, ...],
        parameters: Rows[KernelParameters],
    ) -> tuple[Any, bool]:
        """Overwrite the stored state with that after the tick.

        Parameters
        ----------
        rows : Rows[StoredState]
            State after the last tick.
        memory : Any
            Memory of the estimator.
        observation : tuple
            Numbers of an `ObservationStruct`.
        setpoint : tuple
            Numbers of a `Setpoint`.
        settings : tuple
            Settings of the estimator's kernel.
        parameters : Rows[KernelParameters]
            Settings of the other parts of the servo.

        Returns
        -------
        tuple
            Memory of the estimator, and True if the cause changed.
        """
        stored = rows[0]
        cause = stored.decision.mode.cause
        store_inputs(stored, observation, setpoint)
        context = TickContext(stored, stored.monitor.observation, stored.setpoint, parameters[0])
        memory = step(kernel_class(*settings), memory, context)
        return memory, stored.decision.mode.cause != cause

    return tick


@compiled
def store_inputs(
    stored: StoredState, observation: tuple[Any, ...], setpoint: tuple[Any, ...]
) -> None:
    """Copy the inputs of a tick into the state; plain tuples pass from Python in the least time."""
    store_observation(stored.monitor.observation, ObservationStruct(*observation))
    store_setpoint(stored.setpoint, Setpoint(*setpoint))


@compiled
def step(kernel: Any, memory: Any, tick: TickContext) -> Any:
    """Make one tick and return the memory of the estimator.

    The checks compare the frame with the prediction of the fit and accept or reject it. The
    estimator updates o_c and Ĵ from an accepted frame. `conclude` computes the command.
    """
    frame_result, dt = accept_frame(tick)
    if frame_result == FRAME_UPDATES:
        memory, frame_result = update_estimator(kernel, memory, tick, dt)
    return empty_memory(kernel, memory) if conclude(tick, frame_result) else memory


@compiled
def conclude(tick: TickContext, frame_result: int) -> bool:
    """Make the part of a tick after the update of the estimator.

    The controller predicts the error for the present joints and computes v and the joint rates. The
    checks collect the causes, the state machine chooses the mode, and the gate bounds the rates.
    Return True if the estimate was reset.
    """
    locate_marker(tick)
    if frame_result == FRAME_UPDATES:
        store_estimate(tick)
    elif tick.setpoint.is_new:
        predict_target(tick)
    compute_command(tick, frame_result)
    if frame_result == FRAME_UPDATES or tick.setpoint.is_new:
        compare_target_with_fit(tick)
    causes = collect_causes(tick)
    was_reset = choose_mode(tick, causes, frame_result)
    was_reset = bound_rates(tick) or was_reset
    if tick.stored.monitor.first_frame_is_wrong:
        reset_monitor(tick.stored.monitor, True)
        reset_estimation(tick.stored)
        was_reset = True
    if was_reset:
        reset_fit(tick.stored.projection_fit)
    return was_reset


@compiled
def locate_marker(tick: TickContext) -> None:
    """Write the position of marker 1 by the present joints."""
    p1 = tick.stored.workspace.present_p1
    p1[0], p1[1], p1[2] = compute_position_tuple(
        make_rcm_struct(tick.parameters), tick.observation.q
    )


@compiled
def begin_tick(
    rows: Rows[StoredState],
    line_memory: Floats,
    observation: tuple[Any, ...],
    setpoint: tuple[Any, ...],
    parameters: Rows[KernelParameters],
) -> tuple[Floats, int, float]:
    """Make the part of a tick before the update of an estimator that does not compile.

    Parameters
    ----------
    rows : Rows[StoredState]
        State after the last tick, which is overwritten.
    line_memory : Floats
        Memory of the paper's eq. (16), from which the imaged RCM is estimated.
    observation : tuple
        Fields of the observation.
    setpoint : tuple
        Fields of the setpoint.
    parameters : Rows[KernelParameters]
        Settings of the servo.

    Returns
    -------
    tuple
        The memory with the line of this frame; the result of the frame, `FRAME_UPDATES` if it must
        update the estimator; the time in s between its exposure and that of the last update.
    """
    stored = rows[0]
    store_inputs(stored, observation, setpoint)
    context = TickContext(stored, stored.monitor.observation, stored.setpoint, parameters[0])
    frame_result, dt = accept_frame(context)
    if frame_result == FRAME_UPDATES:
        line_memory, frame_result = fit_frame(context, line_memory)
    return line_memory, frame_result, dt


@compiled
def finish_tick(
    rows: Rows[StoredState], frame_result: int, parameters: Rows[KernelParameters]
) -> bool:
    """Make the part of a tick after the update of an estimator that does not compile.

    The estimator has stored its result. Return True if the estimate was reset.
    """
    stored = rows[0]
    context = TickContext(stored, stored.monitor.observation, stored.setpoint, parameters[0])
    return conclude(context, frame_result)
