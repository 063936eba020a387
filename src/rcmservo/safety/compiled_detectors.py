"""Compiled form of `find_causes`.

The module imports Numba; `declare_in` therefore delays its import until a kernel is compiled.
"""

from functools import partial
from typing import Any

from numba.extending import overload

from rcmservo.safety.causes import DETECTORS, find_causes

overload_inline: Any = partial(overload, strict=False, jit_options={"forceinline": True})


@overload_inline(find_causes)
def _find_causes(facts: Any) -> Any:
    """Unroll the loop over the detectors: Numba cannot loop over different functions."""
    names: dict[str, Any] = {f"detects_{bit}": detects for bit, detects in DETECTORS}
    names["__name__"] = __name__
    terms = (f"({bit} if detects_{bit}(facts) else 0)" for bit, _ in DETECTORS)
    exec(f"def find_causes(facts): return {' | '.join(terms)}", names)
    return names["find_causes"]
