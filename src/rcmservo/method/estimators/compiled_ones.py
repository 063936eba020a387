"""The estimators that a step can be compiled with, as one set of functions: which is meant is told
by the type of the memory."""

from functools import partial
from typing import Any, cast

import numpy as np
from numba.core import types
from numba.extending import overload

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.dlt import DltEstimator, DltMemory, DltRule, located
from rcmservo.method.estimators.dlt import jacobian_at as dlt_jacobian
from rcmservo.method.estimators.dlt import update as dlt_update
from rcmservo.method.estimators.projection import ProjectionEstimator, ProjectionMemory, Rule
from rcmservo.method.estimators.projection import jacobian_at as projection_jacobian
from rcmservo.method.estimators.projection import update as projection_update
from rcmservo.method.tool import Shaft

declared: Any = partial(overload, strict=False)
COMPILED = ProjectionEstimator, DltEstimator

Memory = ProjectionMemory | DltMemory
AnyRule = Rule | DltRule


def rule_of(estimator: Estimator) -> AnyRule | None:
    """What compiled functions know of an estimator; None where it is none of these, or one derived
    from them."""
    if type(estimator) in COMPILED:
        return cast(ProjectionEstimator | DltEstimator, estimator).rule
    return None


@compiled
def projection_learned(
    memory: ProjectionMemory,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    dt: float,
    rule: Rule,
    shaft: Shaft,
) -> tuple[ProjectionMemory, Floats, Floats]:
    """`learned` by rule (21)."""
    memory = projection_update(memory, p1, points, o_c, dt, rule, shaft)
    J_hat = projection_jacobian(memory.a_hat, p1, points, o_c, shaft)
    return memory, J_hat, points


@compiled
def dlt_learned(
    memory: DltMemory,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    dt: float,
    rule: DltRule,
    shaft: Shaft,
) -> tuple[DltMemory, Floats, Floats]:
    """`learned` by the direct linear transformation."""
    memory = dlt_update(memory, p1, points, rule, shaft)
    J_hat = dlt_jacobian(memory, p1, points, o_c, shaft)
    return memory, J_hat, located(memory, p1, shaft)


@compiled
def projection_emptied(memory: ProjectionMemory) -> ProjectionMemory:
    """`emptied` of rule (21)."""
    return ProjectionMemory(np.zeros_like(memory.observations), 0, np.zeros_like(memory.a_hat))


@compiled
def dlt_emptied(memory: DltMemory) -> DltMemory:
    """`emptied` of the direct linear transformation."""
    nowhere, zero = np.full_like(memory.origin, np.nan), np.zeros(3)
    return DltMemory(
        np.zeros_like(memory.sums), nowhere, np.zeros_like(memory.theta),
        zero, np.zeros_like(memory.offset), 0.0, zero.copy(),
    )  # fmt: skip


LEARNED = {ProjectionMemory: projection_learned, DltMemory: dlt_learned}
EMPTIED = {ProjectionMemory: projection_emptied, DltMemory: dlt_emptied}


def learned(
    memory: Any, p1: Floats, points: Floats, o_c: Floats, dt: float, rule: Any, shaft: Shaft
) -> tuple[Any, Floats, Floats]:
    """The memory after one new frame, Ĵ (3, 3) there, and where the markers are (2, 2) raw px."""
    return LEARNED[type(memory)](memory, p1, points, o_c, dt, rule, shaft)


def emptied(memory: Any) -> Any:
    """The memory before the first frame."""
    return EMPTIED[type(memory)](memory)


def _of(functions: Any, memory: Any) -> Any:
    """The one of these functions that a compiled caller means."""
    assert isinstance(memory, types.NamedTuple)
    return functions[cast(Any, memory).instance_class].py_func


@declared(learned)
def _learned(memory: Any, p1: Any, points: Any, o_c: Any, dt: Any, rule: Any, shaft: Any) -> Any:
    return _of(LEARNED, memory)


@declared(emptied)
def _emptied(memory: Any) -> Any:
    return _of(EMPTIED, memory)
