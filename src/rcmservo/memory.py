"""Memory of compiled functions that is neither asked for nor counted.

To ask for the memory of a small array and to give it back takes as long as most of what is done
with it, and so does counting who refers to an array each time that it is passed on.
"""

from typing import TypeVar

import numpy as np

from rcmservo.compiled import declare_in
from rcmservo.interfaces import Floats

Things = TypeVar("Things")

declare_in("rcmservo.memory_compiled")


def scratch(n: int) -> Floats:
    """Room for n numbers, not yet set, that a function needs only while it runs: in compiled
    functions it lies on the stack. So it must never be returned, nor kept by anything."""
    return np.empty(n)


def scratch_table(n: int, m: int) -> Floats:
    """The same for (n, m) numbers."""
    return np.empty((n, m))


def unowned(things: Things) -> Things:
    """The same arrays, or tuples of arrays, but nothing counts who refers to them: whoever calls
    must keep them for as long as they are in use."""
    return things
