"""Numba overloads of four functions in update_estimate.py, chosen by the class of the kernel.

Numba's `overload` registers a function that receives the types of the arguments and returns the
implementation to compile, a plain Python function (``py_func``). This module imports Numba, so
`declare_in` in update_estimate.py defers its import until a kernel is compiled.
"""

from functools import partial
from typing import Any

from numba.extending import overload

from rcmservo.servo.update_estimate import (
    UPDATES,
    empty_memory,
    empty_own_memory,
    empty_with_lines,
    run_kernel,
    update_estimator,
)

declared: Any = partial(overload, strict=False)
"""Numba's `overload`. It does not compare the names of the arguments, which differ between the
function and its implementations."""


@declared(update_estimator)
def _select_update(kernel: Any, memory: Any, tick: Any, dt: Any) -> Any:
    update: Any = UPDATES[kernel.instance_class.estimates_rcm]
    return update.py_func


@declared(empty_memory)
def _select_reset(kernel: Any, memory: Any) -> Any:
    if kernel.instance_class.estimates_rcm:
        return kernel.instance_class.reset.py_func
    with_lines: Any = empty_with_lines
    return with_lines.py_func


@declared(run_kernel)
def _select_kernel_update(kernel: Any, memory: Any, sample: Any, fit: Any, result: Any) -> Any:
    return kernel.instance_class.update.py_func


@declared(empty_own_memory)
def _select_kernel_reset(kernel: Any, memory: Any) -> Any:
    return kernel.instance_class.reset.py_func
