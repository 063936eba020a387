"""What a user's own estimator remembers at a tick, as a record keeps it: a message before the
tick's.

In columns it is the tick's ``memory`` (N, n), NaN at the ticks of estimators that keep less.
"""

from collections.abc import Mapping

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick

TOPIC = "rcmservo/memory"


def numbers_of(tick: Tick) -> Floats | None:
    """What the estimator of a tick remembers (n,), or None where it keeps nothing."""
    return tick.servo.learner.remembered(tick.state.learnt.memory)


def column(kept: Mapping[int, Floats], count: int) -> dict[str, Floats]:
    """The column of `count` ticks, of which some have kept something; no column where none has."""
    rows = {i: numbers for i, numbers in kept.items() if i < count}
    if not rows:
        return {}
    table = np.full((count, max(map(len, rows.values()))), np.nan)
    for i, numbers in rows.items():
        table[i, : len(numbers)] = numbers
    return {"memory": table}
