"""A tick as one compiled function, from observation to command, where rule (21) learns.

The parts are those of look.py and act.py. Other estimators go through them one by one, and the
answers are the same to the last bit. In a live loop nothing of a step is in the processor's caches
any more, and every call from Python costs as much as what it calls.
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.guard.watch import Told
from rcmservo.method.estimators.projection import ProjectionMemory, Rule, jacobian_at, update
from rcmservo.servo.act import Kept, act
from rcmservo.servo.dials import Asked, Fixed
from rcmservo.servo.look import LEARN, learn, look


@compiled
def tick(
    kept: Kept, memory: ProjectionMemory, seen: Told, asked: Asked, fixed: Fixed, rule: Rule
) -> tuple[Kept, ProjectionMemory]:
    """What is kept after one tick."""
    explored = kept.tour[0].done
    watch, estimate, lines, news, dt = look(
        kept.watch, kept.estimate, kept.lines, seen, explored, fixed
    )
    if news == LEARN:
        e = estimate[0]
        memory = update(memory, e.p1, seen.points, e.o_c, dt, rule, fixed.shaft)
        J_hat = jacobian_at(memory.a_hat, e.p1, seen.points, e.o_c, fixed.shaft)
        learn(watch, estimate, J_hat, asked.points, seen.exposure, explored, fixed.thresholds)
    now = Kept(watch, estimate, kept.tour, kept.decision, lines)
    after, forgot = act(now, news, 0, seen, asked, fixed)
    if forgot:
        memory = ProjectionMemory(np.zeros_like(memory.observations), 0, np.zeros(9))
    return after, memory
