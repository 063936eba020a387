"""The compiled form of `find_causes`. It imports Numba, so nothing imports it before a kernel is
compiled.
"""

from functools import partial
from typing import Any

from numba.extending import overload

from rcmservo.safety.causes import DETECTORS, find_causes

declared: Any = partial(overload, strict=False, jit_options={"forceinline": True})


@declared(find_causes)
def _find_causes(facts: Any) -> Any:
    """Write the loop over the detectors out: Numba has none over different functions."""
    names: dict[str, Any] = {f"detects_{bit}": detects for bit, detects in DETECTORS}
    names["__name__"] = __name__
    terms = (f"({bit} if detects_{bit}(facts) else 0)" for bit, _ in DETECTORS)
    exec(f"def find_causes(facts): return {' | '.join(terms)}", names)
    return names["find_causes"]
