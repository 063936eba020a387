"""A tick as one compiled function, where rule (21) learns and there is an estimate to servo with.

The parts are those of core.py. Other estimators go through them one by one, and so does this one
while it explores; the answers are the same to the last bit. In a live loop nothing of a step is in
the processor's caches any more, and every call from Python costs as much as what it calls.
"""

from typing import NamedTuple

from rcmservo.compiled import compiled
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Told, Watch
from rcmservo.interfaces import Floats
from rcmservo.method.estimators.projection import ProjectionMemory, Rule, jacobian_at, update
from rcmservo.method.tool import Shaft
from rcmservo.rows import Rows
from rcmservo.servo.core import LEARN, Dials, Situation, decide, learn, look
from rcmservo.servo.state import Course, Estimate


class Kept(NamedTuple):
    """What a tick changes."""

    watch: Rows[Watch]
    """What the checks remember."""
    estimate: Rows[Estimate]
    """What frames have taught, in numbers."""
    lines: Floats
    """The imaged tool's lines that eq. (16) is made of."""
    memory: ProjectionMemory
    """What rule (21) remembers."""
    course: Rows[Course]
    """Where the servo wants to go."""


class Fixed(NamedTuple):
    """What no tick changes."""

    dials: Rows[Dials]
    """What the compiled parts know of the boxes."""
    thresholds: Rows[Thresholds]
    """From where on something is a fault."""
    rule: Rule
    """What they know of rule (21)."""
    shaft: Shaft
    """What they know of the tool."""


@compiled
def tick(
    kept: Kept, seen: Told, situation: Situation, target: Floats, fixed: Fixed
) -> tuple[Kept, int, int]:
    """What is kept after one tick on the way to the `target` (2, 2) px, what the tick brought, and
    the causes that are there at it."""
    watch, estimate, lines, news, dt = look(
        kept.watch, kept.estimate, kept.lines, seen, True, fixed.dials, fixed.thresholds
    )
    memory = kept.memory
    if news == LEARN:
        e = estimate[0]
        memory = update(memory, e.p1, seen.points, e.o_c, dt, fixed.rule, fixed.shaft)
        J_hat = jacobian_at(memory.a_hat, e.p1, seen.points, e.o_c, fixed.shaft)
        learn(watch, estimate, J_hat, target, seen.exposure, True, fixed.thresholds)
    course, found = decide(
        watch, estimate, kept.course, seen, situation, fixed.dials, fixed.thresholds
    )
    return Kept(watch, estimate, lines, memory, course), news, found
