"""A tick as one compiled function, from observation to command, with an estimator that compiles.

The parts are those of look.py and act.py. Other estimators go through them one by one, and the
answers are the same to the last bit. In a live loop nothing of a step is in the processor's caches
any more, and every call from Python costs as much as what it calls.
"""

from rcmservo.compiled import compiled
from rcmservo.guard.watch import Told
from rcmservo.method.estimators.compiled_ones import AnyRule, Memory, emptied, learned
from rcmservo.servo.act import Kept, act
from rcmservo.servo.dials import Asked, Fixed
from rcmservo.servo.look import LEARN, learn, look


@compiled
def tick(
    kept: Kept, memory: Memory, seen: Told, asked: Asked, fixed: Fixed, rule: AnyRule
) -> tuple[Kept, Memory]:
    """What is kept after one tick."""
    explored = kept.tour[0].done
    watch, estimate, lines, news, dt = look(
        kept.watch, kept.estimate, kept.lines, seen, explored, fixed
    )
    if news == LEARN:
        e = estimate[0]
        memory, J_hat, points = learned(memory, e.p1, seen.points, e.o_c, dt, rule, fixed.shaft)
        learn(estimate, J_hat, points, asked.points, seen.exposure)
    now = Kept(watch, estimate, kept.tour, kept.decision, lines)
    after, forgot = act(now, news, 0, seen, asked, fixed)
    if forgot:
        memory = emptied(memory)
    return after, memory
