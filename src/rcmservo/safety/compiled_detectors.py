"""Compiled form of `find_causes`, the function that calls the detectors of all causes.

The module imports Numba; `declare_in` therefore delays its import until a kernel is compiled.
"""

from functools import partial
from typing import Any

from numba.extending import overload

from rcmservo.safety.causes import DETECTORS, find_causes

declared: Any = partial(overload, strict=False, jit_options={"forceinline": True})


@declared(find_causes)
def _generate_find_causes(facts: Any) -> Any:
    """Generate the function without its loop: Numba cannot loop over different functions."""
    namespace: dict[str, Any] = {f"detector_{bit}": detector for bit, detector in DETECTORS}
    namespace["__name__"] = __name__
    terms = (f"({bit} if detector_{bit}(facts) else 0)" for bit, _ in DETECTORS)
    exec(f"def find_causes(facts): return {' | '.join(terms)}", namespace)
    return namespace["find_causes"]
