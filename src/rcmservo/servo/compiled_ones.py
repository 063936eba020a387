"""The estimators that a step can be compiled with, as one set of functions: which is meant is told
by the type of the memory."""

from typing import Any, cast

import numpy as np

from rcmservo.compiled import compiled, declare_in
from rcmservo.interfaces import Floats, ObservationStruct
from rcmservo.memory import scratch_table
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.projection import (
    ProjectionEstimator,
    ProjectionMemory,
    Rule,
    markers_jacobian,
)
from rcmservo.method.estimators.projection import jacobian_at as projection_jacobian
from rcmservo.method.estimators.projection import update as projection_update
from rcmservo.method.foresight import add_offset, expect, motions
from rcmservo.method.prospect import see
from rcmservo.rows import Rows
from rcmservo.servo.kernel_parameters import KernelParameters, shaft_of
from rcmservo.servo.learn import (
    LEARN,
    learn,
    learn_points,
    learn_straight,
    line_up,
    place_by_fit,
)
from rcmservo.servo.state import Beside, Kept

COMPILED = ProjectionEstimator, DltEstimator

AnyRule = Rule | tuple[()]


def rule_of(estimator: Estimator) -> AnyRule | None:
    """What compiled functions know of an estimator; None where it is none of these, or one derived
    from them."""
    if type(estimator) in COMPILED:
        return cast(ProjectionEstimator | DltEstimator, estimator).rule
    return None


@compiled
def by_rule_21(
    kept: Rows[Kept],
    beside: Beside,
    seen: ObservationStruct,
    target: Floats,
    dt: float,
    rule: Rule,
    fixed: Rows[KernelParameters],
) -> tuple[Beside, int]:
    """`learned` by rule (21)."""
    lines, news = line_up(kept, beside.lines, seen.points, fixed)
    memory, e, shaft = beside.memory, kept[0].estimate, shaft_of(fixed[0])
    if news == LEARN:
        memory = projection_update(memory, e.p1, seen.points, e.o_c, dt, rule, shaft)
        J_hat = projection_jacobian(memory.a_hat, e.p1, seen.points, e.o_c, shaft)
        learn(kept, J_hat, seen.points, target, seen.exposure)
        if fixed[0].features > 3:
            motion = markers_jacobian(memory.a_hat, e.p1, shaft)
            learn_points(kept, motion, seen.points, target)
    return Beside(lines, memory), news


@compiled
def by_whole_fit(
    kept: Rows[Kept],
    beside: tuple[()],
    seen: ObservationStruct,
    target: Floats,
    dt: float,
    rule: tuple[()],
    fixed: Rows[KernelParameters],
) -> tuple[tuple[()], int]:
    """`learned` by the direct linear transformation: what the camera should see is all it is."""
    e, v, shaft = kept[0].estimate, kept[0].prospect, shaft_of(fixed[0])
    frames = v.frames
    see(v, e.p1, seen.points, shaft)
    if v.frames > frames or e.rcm_condition > 0.0:  # otherwise it is where it was
        place_by_fit(kept)
    points, motion = scratch_table(2, 2), scratch_table(4, 3)
    expect(v, e.p1, shaft, points)
    add_offset(v, points)
    motions(v, e.p1, shaft, motion)
    learn_straight(kept, motion, points, target, seen.exposure)
    if fixed[0].features > 3:
        learn_points(kept, motion, points, target)
    return beside, LEARN


@compiled
def rule_21_emptied(beside: Beside) -> Beside:
    """`emptied` of rule (21)."""
    memory = beside.memory
    empty = ProjectionMemory(np.zeros_like(memory.observations), 0, np.zeros_like(memory.a_hat))
    return Beside(np.zeros_like(beside.lines), empty)


@compiled
def whole_fit_emptied(beside: tuple[()]) -> tuple[()]:
    """`emptied` of the direct linear transformation."""
    return beside


LEARNED = {Beside: by_rule_21, tuple: by_whole_fit}
EMPTIED = {Beside: rule_21_emptied, tuple: whole_fit_emptied}


def learned(
    kept: Rows[Kept],
    beside: Any,
    seen: ObservationStruct,
    target: Floats,
    dt: float,
    rule: Any,
    fixed: Rows[KernelParameters],
) -> tuple[Any, int]:
    """What is remembered beside after one new frame that is believed, with the `target`'s markers
    (2, 2) raw px, and what it brought."""
    return LEARNED[type(beside)](kept, beside, seen, target, dt, rule, fixed)


def emptied(beside: Any) -> Any:
    """The same before the first frame."""
    return EMPTIED[type(beside)](beside)


declare_in("rcmservo.servo.compiled_choice")
