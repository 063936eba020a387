"""One tick, from observation to command, with an estimator that compiles: one compiled function.

In a live loop nothing of a step is in the processor's caches any more, and every array and named
tuple that is passed from Python, or back, costs as much as a good part of the tick: so there are as
few as can be, and rows are written over. An estimator that does not compile is called in Python
between `begin_tick` and `finish_tick`, which are made of the same parts: the answers are the same
to the last bit.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats, ObservationStruct
from rcmservo.memory import unowned
from rcmservo.method.estimators.base import EstimatorKernel
from rcmservo.method.prospect import empty
from rcmservo.rows import Rows
from rcmservo.servo.accept_frame import accept_frame
from rcmservo.servo.apply_mode import bound_rates, choose_mode
from rcmservo.servo.collect_causes import collect_causes
from rcmservo.servo.compute_command import compute_command
from rcmservo.servo.kernel_parameters import KernelParameters, Setpoint, TickContext
from rcmservo.servo.state import Stored
from rcmservo.servo.update_estimate import (
    LEARN,
    empty_memory,
    fit_frame,
    take_estimate,
    update_estimator,
)


@cache
def tick_of(kind: type[EstimatorKernel]) -> Callable[..., tuple[Any, bool]]:
    """Return the compiled tick of a class of estimator kernels. Its settings are passed as a plain
    tuple, as a named one costs a twentieth of the tick."""
    kernel_class: Any = kind

    @compiled
    def tick(
        rows: Rows[Stored],
        memory: Any,
        observation: tuple[Any, ...],
        setpoint: tuple[Any, ...],
        settings: tuple[Any, ...],
        parameters: Rows[KernelParameters],
    ) -> tuple[Any, bool]:
        """Write one tick over what is stored, with the numbers of an `ObservationStruct` and of a
        `Setpoint`; return the estimator's memory, and whether the cause is another than before."""
        rows, parameters = unowned(rows), unowned(parameters)
        cause = rows[0].decision.mode.cause
        seen, aim = ObservationStruct(*observation), Setpoint(*setpoint)
        now = TickContext(rows[0], seen, aim, parameters[0])
        memory = step(kernel_class(*settings), memory, now)
        return memory, rows[0].decision.mode.cause != cause

    return tick


@compiled
def step(kernel: Any, memory: Any, now: TickContext) -> Any:
    """Make one tick, and return the estimator's memory.

    The checks compare the frame with what the fit predicts and accept or reject it, the estimator
    updates o_c and Ĵ from an accepted frame, and the tick concludes.
    """
    news, dt = accept_frame(now)
    if news == LEARN:
        memory, news = update_estimator(kernel, memory, now, dt)
    return empty_memory(kernel, memory) if conclude(now, news, False) else memory


@compiled
def conclude(now: TickContext, news: int, failed: bool) -> bool:
    """Conclude a tick after the estimator's update, which may have `failed`.

    The controller predicts the error for the present joints and computes v and the joint rates, the
    checks collect the causes, the state machine chooses the mode, and the gate bounds the rates.
    Return whether the estimate is forgotten.
    """
    if news == LEARN:
        take_estimate(now)
    compute_command(now, news)
    causes = collect_causes(now, failed)
    forgotten = choose_mode(now, causes, news)
    forgotten = bound_rates(now) or forgotten
    if forgotten:
        empty(now.stored.prospect)
    return forgotten


@compiled
def begin_tick(
    rows: Rows[Stored],
    lines: Floats,
    observation: tuple[Any, ...],
    setpoint: tuple[Any, ...],
    parameters: Rows[KernelParameters],
) -> tuple[Floats, int, float]:
    """Begin a tick with an estimator that does not compile; return the lines of eq. (16), whether
    the estimator is to be updated (LEARN), and the time since its last update, s."""
    seen, aim = ObservationStruct(*observation), Setpoint(*setpoint)
    now = TickContext(rows[0], seen, aim, parameters[0])
    news, dt = accept_frame(now)
    if news == LEARN:
        lines, news = fit_frame(now, lines)
    return lines, news, dt


@compiled
def finish_tick(
    rows: Rows[Stored],
    news: int,
    failed: bool,
    observation: tuple[Any, ...],
    setpoint: tuple[Any, ...],
    parameters: Rows[KernelParameters],
) -> bool:
    """Finish it, after the estimator has left its result or `failed`."""
    seen, aim = ObservationStruct(*observation), Setpoint(*setpoint)
    return conclude(TickContext(rows[0], seen, aim, parameters[0]), news, failed)
