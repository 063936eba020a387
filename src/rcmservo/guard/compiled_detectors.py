"""The compiled form of `find_causes`. It imports Numba, so nothing imports it before a kernel is
compiled."""

from functools import partial
from typing import Any

from numba import njit
from numba.extending import overload

from rcmservo.compiled import OPTIONS
from rcmservo.guard.causes import DETECTORS, find_causes

declared: Any = partial(overload, strict=False, jit_options={"forceinline": True})
inlined: Any = njit(inline="always", **OPTIONS)


@declared(find_causes)
def _find_causes(facts: Any) -> Any:
    """Write the loop over the detectors out, as Numba has none over different functions. They
    become part of one function: to compile each by itself takes a fifth longer in all."""
    names: dict[str, Any] = {f"detects_{bit}": inlined(one.py_func) for bit, one in DETECTORS}
    terms = (f"({bit} if detects_{bit}(facts) else 0)" for bit, _ in DETECTORS)
    exec(f"def find_causes(facts): return {' | '.join(terms)}", names)
    return names["find_causes"]
