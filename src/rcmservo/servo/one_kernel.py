"""A tick as one compiled function, from observation to command, with an estimator that compiles.

The parts are those of look.py, learn.py and act.py. Other estimators go through them one by one,
and the answers are the same to the last bit. In a live loop nothing of a step is in the processor's
caches any more, and every array and named tuple that is passed from Python, or back, costs as much
as a good part of the tick: so there are as few as can be, and rows are written over.
"""

from typing import Any

from rcmservo.compiled import compiled
from rcmservo.interfaces import ObservationStruct
from rcmservo.memory import unowned
from rcmservo.rows import Rows
from rcmservo.servo.act import act
from rcmservo.servo.compiled_ones import AnyRule, emptied, learned
from rcmservo.servo.kernel_parameters import Asked, KernelParameters
from rcmservo.servo.learn import LEARN
from rcmservo.servo.look import look
from rcmservo.servo.state import Beside, Kept


@compiled
def tick(
    kept: Rows[Kept],
    beside: Beside | tuple[()],
    seen: tuple[Any, ...],
    asked: tuple[Any, ...],
    fixed: Rows[KernelParameters],
    rule: AnyRule,
) -> tuple[Beside | tuple[()], bool]:
    """Write one tick over what is kept, with the numbers of an `ObservationStruct` and of an
    `Asked`; what is remembered beside, and whether there is another cause than before."""
    kept, fixed = unowned(kept), unowned(fixed)
    cause = kept[0].decision.mode.cause
    beside = go_on(kept, beside, ObservationStruct(*seen), Asked(*asked), fixed, rule)
    return beside, kept[0].decision.mode.cause != cause


@compiled
def go_on(
    kept: Rows[Kept],
    beside: Beside | tuple[()],
    seen: ObservationStruct,
    asked: Asked,
    fixed: Rows[KernelParameters],
    rule: AnyRule,
) -> Beside | tuple[()]:
    """`tick` as a batch goes through it."""
    news, dt = look(kept, seen, fixed)
    if news == LEARN:
        beside, news = learned(kept, beside, seen, asked.points, dt, rule, fixed)
    if act(kept, news, False, seen, asked, fixed):
        beside = emptied(beside)
    return beside
