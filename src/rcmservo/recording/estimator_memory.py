"""State of a user-defined estimator in a record: one message before each tick.

As a column it is the tick's ``memory`` (N, n), NaN at the ticks of estimators with a smaller state.
"""

from collections.abc import Mapping

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick

TOPIC = "rcmservo/memory"


def recorded_memory(tick: Tick) -> Floats | None:
    """Return the estimator state of a tick (n,), or None if the estimator records none."""
    return tick.servo.guarded_estimator.recorded_numbers(tick.state.estimation.memory)


def memory_column(memories: Mapping[int, Floats], count: int) -> dict[str, Floats]:
    """Return the column of `count` ticks from the recorded states, by name; empty without any."""
    rows = {i: numbers for i, numbers in memories.items() if i < count}
    if not rows:
        return {}
    table = np.full((count, max(map(len, rows.values()))), np.nan)
    for i, numbers in rows.items():
        table[i, : len(numbers)] = numbers
    return {"memory": table}
