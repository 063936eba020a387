"""Update of the estimate by an accepted frame: fit of the projection, imaged RCM, Ĵ and features.

An estimator that compiles is part of this by its kernel, chosen by the kernel's class
(estimator_kernels.py). One that does not is called in Python, between `fit_frame` and
`take_estimate`.
"""

from typing import Any, cast

import numpy as np

from rcmservo.estimation.base import Estimate, KernelSample
from rcmservo.estimation.projection_fit import see
from rcmservo.geometry.features import (
    POINTS,
    SRD,
    along_line,
    measured,
    near_origin,
    shift,
    straight_jacobian,
    wrapped,
)
from rcmservo.geometry.imaged_rcm import follow
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled, declare_in
from rcmservo.numerics.small_linalg import all_finite, multiply, put
from rcmservo.safety.monitor_state import watch_estimate
from rcmservo.servo.kernel_parameters import TickContext, shaft_of
from rcmservo.servo.state import EstimatorMemory, Workspace

NOTHING, BELIEVED, LEARN = 0, 1, 2
"""Result of a tick: no frame accepted, one accepted, or one that also updates Ĵ."""

REACH = 800.0
"""px from the markers to the origin of their features at most."""


@compiled
def fit_frame(tick: TickContext, lines: Floats) -> tuple[Floats, int]:
    """Take the markers, of which one may be lost, into the fit of the projection, and into the
    lines of eq. (16).

    Returns
    -------
    tuple
        The lines after the frame, and LEARN if they determine the imaged RCM or the estimator
        gives it, else BELIEVED.
    """
    e, points, parameters = tick.stored.estimate, tick.observation.points, tick.parameters
    see(tick.stored.prospect, e.p1, points, shaft_of(parameters))
    otherwise = LEARN if parameters.places_rcm else BELIEVED
    if not all_finite(points):
        return lines, otherwise
    known, printed = parameters.imaged_rcm, parameters.printed_rcm
    lines, count, o_c, e.rcm_condition = follow(
        lines, e.line_count, points, known.refinements, printed
    )
    put(e.o_c, o_c)
    e.line_count = count
    return lines, LEARN if e.rcm_condition <= known.max_condition else otherwise


@compiled
def sample_of(tick: TickContext, dt: float, fit_changed: bool) -> KernelSample:
    """Return the frame as an estimator's kernel sees it."""
    e, parameters, points = tick.stored.estimate, tick.parameters, tick.observation.points
    shaft, needs_motion = shaft_of(parameters), parameters.needs_motion
    return KernelSample(e.p1, points, e.o_c, dt, shaft, needs_motion, fit_changed)


@compiled
def update_with_lines(
    kernel: Any, memory: EstimatorMemory, tick: TickContext, dt: float
) -> tuple[EstimatorMemory, int]:
    """`update_estimator`, about the imaged RCM of eq. (16)."""
    lines, news = fit_frame(tick, memory.lines)
    own, s = memory.memory, tick.stored
    if news == LEARN:
        own = run_kernel(kernel, own, sample_of(tick, dt, True), s.prospect, s.estimated)
    return EstimatorMemory(lines, own), news


@compiled
def update_with_fit(kernel: Any, memory: Any, tick: TickContext, dt: float) -> tuple[Any, int]:
    """`update_estimator`, where the estimator gives the imaged RCM."""
    e, fit, result = tick.stored.estimate, tick.stored.prospect, tick.stored.estimated
    frames = fit.frames
    see(fit, e.p1, tick.observation.points, shaft_of(tick.parameters))
    put(result.o_c, e.o_c)
    put(result.o_c_covariance, e.o_c_covariance)
    sample = sample_of(tick, dt, fit.frames > frames or e.rcm_condition > 0.0)
    return run_kernel(kernel, memory, sample, fit, result), LEARN


@compiled
def empty_with_lines(kernel: Any, memory: EstimatorMemory) -> EstimatorMemory:
    """`empty_memory`, with the lines of eq. (16)."""
    return EstimatorMemory(np.zeros_like(memory.lines), empty_own(kernel, memory.memory))


UPDATES = {False: update_with_lines, True: update_with_fit}
"""Functions by whether the estimator gives the imaged RCM."""


def update_estimator(kernel: Any, memory: Any, tick: TickContext, dt: float) -> tuple[Any, int]:
    """Update an estimator that compiles, by an accepted frame dt s after the one before.

    Returns
    -------
    tuple
        What it stores, and LEARN if it gave a result, else BELIEVED.
    """
    return UPDATES[kernel.places_rcm](kernel, memory, tick, dt)


def empty_memory(kernel: Any, memory: Any) -> Any:
    """Return what the estimator stores before the first frame."""
    return (empty_own if kernel.places_rcm else empty_with_lines)(kernel, memory)


def run_kernel(kernel: Any, memory: Any, sample: KernelSample, fit: Any, result: Any) -> Any:
    """Run the `update` of a kernel's class."""
    update = cast(Any, type(kernel)).update
    return update(kernel, memory, sample, fit, result)


def empty_own(kernel: Any, memory: Any) -> Any:
    """Run the `empty` of a kernel's class."""
    empty = cast(Any, type(kernel)).empty
    return empty(kernel, memory)


declare_in("rcmservo.servo.estimator_kernels")


@compiled
def take_estimate(tick: TickContext) -> None:
    """Measure features and error on the estimator's result, and judge the estimate by them."""
    e, result, code = tick.stored.estimate, tick.stored.estimated, tick.parameters.features.code
    target = tick.setpoint.points
    e.exposure = tick.observation.exposure
    if result.placed:
        put(e.o_c, result.o_c)
        put(e.o_c_covariance, result.o_c_covariance)
        e.rcm_condition = 0.0
        measure_straight(e, result.motion, result.points, target, tick.stored.work)
    else:
        put(e.J_hat, result.J_hat)
        y, delta = measured(result.points, target, e.o_c)
        put(e.y, y)
        put(e.delta, delta)
    if code == SRD:
        put(e.law_jacobian[:3], e.J_hat)
        put(e.law_error[:3], e.delta)
    elif code == POINTS:
        put(e.law_jacobian[:4], result.motion)
        for k in range(4):
            e.law_error[k] = result.points[k // 2, k % 2] - target[k // 2, k % 2]
    if tick.stored.tour.done and e.rcm_condition > 0.0:
        t = tick.parameters.thresholds
        watch_estimate(tick.stored.watch, e.p1, e.points, e.o_c, e.J_hat, t)


@compiled
def measure_straight(
    e: Estimate, motion: Floats, points: Floats, target: Floats, work: Workspace
) -> None:
    """Measure the features of the line through o_c that passes nearest to both markers, and Ĵ of
    the markers' `motion` ∂m/∂p₁ (4, 3).

    Where o_c is very far away, as near the camera's image plane, a point on the way there takes its
    place: at the target any origin gives the same.
    """
    origin, m, m_d, J = near_origin(e.o_c, points, REACH), work.m, work.m_d, work.J_m
    shift(points, origin, m)
    shift(target, origin, m_d)
    straight_jacobian(m, J)
    multiply(J, motion, e.J_hat)
    y, y_d = along_line(m), along_line(m_d)
    e.y[0], e.y[1], e.y[2] = y
    e.delta[0], e.delta[1], e.delta[2] = wrapped(y[0] - y_d[0]), y[1] - y_d[1], y[2] - y_d[2]
