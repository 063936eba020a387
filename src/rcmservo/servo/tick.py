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

from rcmservo.estimation.base import EstimatorKernel
from rcmservo.estimation.projection_fit import empty
from rcmservo.interfaces import Floats, ObservationStruct
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Rows
from rcmservo.safety.monitor_state import store_observation
from rcmservo.servo.accept_frame import accept_frame
from rcmservo.servo.apply_mode import bound_rates, choose_mode
from rcmservo.servo.collect_causes import collect_causes
from rcmservo.servo.compute_command import compute_command
from rcmservo.servo.kernel_parameters import KernelParameters, TickContext
from rcmservo.servo.setpoint import Setpoint, store_setpoint
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
    tuple, as a named one costs a twentieth of the tick.
    """
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
        `Setpoint`; return the estimator's memory, and whether the cause is another than before.
        """
        stored = rows[0]
        cause = stored.decision.mode.cause
        store_inputs(stored, observation, setpoint)
        now = TickContext(stored, stored.watch.observation, stored.setpoint, parameters[0])
        memory = step(kernel_class(*settings), memory, now)
        return memory, stored.decision.mode.cause != cause

    return tick


@compiled
def store_inputs(stored: Stored, observation: tuple[Any, ...], setpoint: tuple[Any, ...]) -> None:
    """Store what the tick is given: the plain tuples that pass from Python in the least time."""
    store_observation(stored.watch.observation, ObservationStruct(*observation))
    store_setpoint(stored.setpoint, Setpoint(*setpoint))


@compiled
def step(kernel: Any, memory: Any, now: TickContext) -> Any:
    """Make one tick, and return the estimator's memory.

    The checks compare the frame with what the fit predicts and accept or reject it, the estimator
    updates o_c and Ĵ from an accepted frame, and the tick concludes.
    """
    news, dt = accept_frame(now)
    if news == LEARN:
        memory, news = update_estimator(kernel, memory, now, dt)
    return empty_memory(kernel, memory) if conclude(now, news) else memory


@compiled
def conclude(now: TickContext, news: int) -> bool:
    """Conclude a tick after the estimator's update.

    The controller predicts the error for the present joints and computes v and the joint rates, the
    checks collect the causes, the state machine chooses the mode, and the gate bounds the rates.
    Return whether the estimate is forgotten.
    """
    if news == LEARN:
        take_estimate(now)
    compute_command(now, news)
    causes = collect_causes(now)
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
    the estimator is to be updated (LEARN), and the time since its last update, s.
    """
    stored = rows[0]
    store_inputs(stored, observation, setpoint)
    now = TickContext(stored, stored.watch.observation, stored.setpoint, parameters[0])
    news, dt = accept_frame(now)
    if news == LEARN:
        lines, news = fit_frame(now, lines)
    return lines, news, dt


@compiled
def finish_tick(rows: Rows[Stored], news: int, parameters: Rows[KernelParameters]) -> bool:
    """Finish it, after the estimator has left its result; return whether the estimate is
    forgotten.
    """
    stored = rows[0]
    now = TickContext(stored, stored.watch.observation, stored.setpoint, parameters[0])
    return conclude(now, news)
